"""Freed memory goes back to the system when it is asked for."""

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import psutil
from morph_engine.memory_return import return_free_memory

blocks = [bytes([1]) * 65_536 for _ in range(3000)]
blocks = blocks[::100]  # what is left keeps the heap from shrinking by itself
before = psutil.Process().memory_info().rss
return_free_memory()
print(before - psutil.Process().memory_info().rss)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a call of glibc")
def test_freed_memory_is_given_back() -> None:
    """Most of 190 MB, in a process that keeps some of it here and there."""
    printed = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, check=True)
    assert int(printed.stdout) > 150e6
