"""Device arrays as the engine takes them for granted."""

from __future__ import annotations

import numpy as np
import pytest

from morph_engine import backend


@pytest.mark.parametrize(
    ("kind", "sizes"),
    [("scalars", [9000]), ("integers", [9000]), ("vectors", [3000]), ("matrices", [1000])],
)
def test_a_new_array_is_zero_where_another_one_was(kind: str, sizes: list[int]) -> None:
    """Also in memory that an earlier array has left."""
    device = backend.start("cpu", threads=1)
    for _ in range(4):
        array = getattr(device, kind)(*sizes)
        values = array.to_numpy()
        assert not values.any()
        array.from_numpy(np.full_like(values, 7))
        del array
