"""Sorting by small whole numbers."""

import numpy as np
import pytest

from morph_engine.counting_sort import counting_sort


@pytest.mark.parametrize("count", [1, 7, 5000])
def test_it_sorts_as_a_stable_sort_by_comparisons(count: int) -> None:
    """And tells where each key begins, whether anything has it or not."""
    keys = np.random.default_rng(0).integers(0, count, 1000)
    order, first = counting_sort(keys, count)
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))
    np.testing.assert_array_equal(first, np.searchsorted(keys[order], np.arange(count + 1)))


def test_nothing_is_sorted() -> None:
    """Without things there is no order."""
    order, first = counting_sort(np.zeros(0, np.int32), 3)
    assert len(order) == 0
    assert first.tolist() == [0, 0, 0, 0]
