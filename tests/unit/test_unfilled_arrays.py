"""Arrays over a whole grid take the memory that is written, and no more."""

import numpy as np
import psutil

from morph_engine import backend
from morph_engine.unfilled_arrays import unfilled

COUNT = 64_000_000
"""Numbers of a large array: 256 MB."""


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(psutil.Process().memory_info().rss)


def test_memory_is_taken_where_something_is_written() -> None:
    """A large array takes nearly nothing; others are zero as ever, and as large as they are."""
    device = backend.start("cpu")
    before = resident()
    with unfilled():
        large = device.scalars(COUNT)
    assert resident() - before < COUNT
    large[5] = 7.0
    assert large[5] == 7.0
    filled = device.scalars(COUNT)
    assert resident() - before > 3 * COUNT
    assert not np.any(filled.to_numpy()[:: COUNT // 100])
