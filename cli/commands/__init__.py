"""The commands of `morph`, one file a group."""
