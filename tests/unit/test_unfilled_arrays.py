"""Arrays over a whole grid take the memory that is written, and no more."""

import subprocess
import sys

import numpy as np
import psutil
import pytest

from morph_engine import backend
from morph_engine.unfilled_arrays import unfilled

COUNT = 64_000_000
"""Numbers of a large array: 256 MB."""


LIMITED = """
from morph_engine import backend
from morph_engine.memory_limit import limit_memory
from morph_engine.unfilled_arrays import unfilled

device = backend.start("cpu")
limit_memory(100_000_000)
with unfilled():
    large = device.scalars(2_000_000_000)
large[5] = 7.0
print(large[5])
try:
    device.scalars(2_000_000_000)
except RuntimeError as error:
    print("refused")
"""


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


@pytest.mark.skipif(sys.platform != "linux", reason="a limit of Linux")
def test_what_is_not_written_does_not_count_for_the_limit() -> None:
    """Beside a limit of 100 MB there is room for an unfilled 8 GB, and not for 8 GB of zeros."""
    done = subprocess.run([sys.executable, "-c", LIMITED], capture_output=True, text=True)
    assert done.stdout.split() == ["7.0", "refused"], done.stderr
