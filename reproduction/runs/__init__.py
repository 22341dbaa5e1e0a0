"""Runs of the engine: what one is, its record on the disk, and how many are computed."""
