"""The service from Python: `MorphClient` blocks, `AsyncMorphClient` awaits."""
