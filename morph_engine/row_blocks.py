"""Long arrays are worked through some rows at a time.

What is computed between then stays in the processor's cache, and takes little memory.
"""

from collections.abc import Iterator

ROWS = 16_384


def row_blocks(count: int) -> Iterator[slice]:
    """The rows of an array that has `count` of them, block by block."""
    for first in range(0, count, ROWS):
        yield slice(first, min(first + ROWS, count))
