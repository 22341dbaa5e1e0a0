"""The different numbers of an array."""

from __future__ import annotations

import numpy as np
import pytest

from morph_engine.distinct import distinct


@pytest.mark.parametrize("kind", [np.int32, np.int64, np.float64])
@pytest.mark.parametrize("shape", [(0,), (1,), (500,), (40, 3)])
def test_each_number_comes_once_and_in_order(kind, shape):
    """Whatever the shape and type of the array, which stays as it is."""
    numbers = np.random.default_rng(0).integers(-50, 50, shape).astype(kind)
    before = numbers.copy()
    found = distinct(numbers)
    assert found.tolist() == sorted(set(numbers.ravel().tolist()))
    assert found.dtype == kind
    assert (numbers == before).all()
