"""Who goes where: one even destination for each particle, and the cheapest way to hand them out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
