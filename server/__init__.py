"""The HTTP service: meshes, jobs, sweeps, results, events and keys, over the worker's queue."""

from morph_engine.optional_packages import require

require("fastapi", "uvicorn", "prometheus_client", extra="service", purpose="The service")
