"""The Python client of the service: `MorphClient` blocks, `AsyncMorphClient` awaits."""

import lazy_loader

from morph_engine.optional_packages import require

require("httpx", "httpx_sse", "anyio", extra="client", purpose="The client of the service")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
