"""Linear algebra on one thread, whoever else asks for it at the same time."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import threadpoolctl

from morph_engine.blas_threads import one_blas_thread


def blas_threads() -> set[int]:
    """Numbers of threads that the libraries of linear algebra take now."""
    libraries = threadpoolctl.threadpool_info()
    return {each["num_threads"] for each in libraries if each["user_api"] == "blas"}


def test_who_leaves_first_lifts_no_limit_of_another() -> None:
    """Of two threads in such blocks, which begin and end at other times."""
    before = blas_threads()
    if before == {1}:
        pytest.skip("linear algebra has one thread here anyway")

    def look(seconds: float) -> set[int]:
        seen = set()
        for _ in range(20):
            with one_blas_thread():
                time.sleep(seconds)
                seen |= blas_threads()
        return seen

    with ThreadPoolExecutor(2) as pool:
        assert set().union(*pool.map(look, (0.002, 0.005))) == {1}
    assert blas_threads() == before
