"""Tasks for the sandbox: each a module with a function `run`, imported in a child process only."""
