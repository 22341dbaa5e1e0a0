"""Morph one 3D shape into another by physics, and measure honestly how well.

    >>> from morph_engine import configure, morph
    >>> config = configure("fast", {"frames": 4, "sampling.points_per_cell_edge": 2})
    >>> for frame in morph("sphere", "star", config):
    ...     print(f"frame {frame.index}: {frame.metrics['two_sided']:.1f} dx from the target")
    frame 0: 1.2 dx from the target
    frame 1: 0.7 dx from the target
    frame 2: 0.4 dx from the target
    frame 3: 0.4 dx from the target

Names are imported when they are first used, and Taichi when a run starts.
"""

import os

import lazy_loader

# Taichi announces itself on stdout, and in a notebook that it has found one
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_ENABLE_PYBUF", "0")
# and once a day tells its makers the version, the platform and a number that stays the same
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
