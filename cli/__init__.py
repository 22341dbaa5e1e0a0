"""The `morph` command line."""
