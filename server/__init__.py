"""The HTTP service: meshes, jobs, sweeps, results, events and keys, over the worker's queue."""
