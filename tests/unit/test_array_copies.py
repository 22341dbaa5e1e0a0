"""Copies between the host and a part of a device array."""

import numpy as np
import pytest

from morph_engine import array_copies, backend


@pytest.mark.parametrize("as_memory", [True, False])
def test_the_front_of_an_array_is_copied(as_memory: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """As memory on a CPU, and by the whole array elsewhere."""
    backend.start("cpu", threads=2)
    monkeypatch.setattr(array_copies, "_shortened", as_memory)
    array = backend.active().vectors(5)
    values = np.random.default_rng(0).random((3, 3), np.float32)
    array_copies.copy_to_front(array, values)
    front = array_copies.copy_of_front(array, 3)
    np.testing.assert_array_equal(front, values)
    array_copies.copy_to_front(array, values[:1] + 1)
    np.testing.assert_array_equal(front, values)
    np.testing.assert_array_equal(array.to_numpy()[0], values[0] + 1)
