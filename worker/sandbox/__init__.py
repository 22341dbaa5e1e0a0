"""What is computed on request, in child processes with limited memory and time."""
