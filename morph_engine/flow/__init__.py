"""Matter that flows inside a body whose shape changes from source to target."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
