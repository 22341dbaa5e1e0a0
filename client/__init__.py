"""The service from Python: `MorphClient` blocks, `AsyncMorphClient` awaits."""

from __future__ import annotations

from chamfer_morph.client.client import AsyncMorphClient, MorphClient
from chamfer_morph.client.errors import ServiceError

__all__ = ["AsyncMorphClient", "MorphClient", "ServiceError"]
