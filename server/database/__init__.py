"""The service's own tables: API keys, meshes, sweeps."""
