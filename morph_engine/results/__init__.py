"""What a run leaves: the run directory, the result file, and what is read from them."""
