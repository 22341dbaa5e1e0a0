from .client import AsyncMorphClient, MorphClient
from .errors import ServiceError

__all__ = ["AsyncMorphClient", "MorphClient", "ServiceError"]
