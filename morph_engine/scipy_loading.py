"""SciPy is imported in two thirds of the time, in processes that compute and show no documentation.

SciPy 1.17 adds a note to the documentation of some hundred functions when it is imported, and takes
each apart and together again for that. And it takes all names of NumPy, its compiler for Fortran
included, which NumPy imports when it is asked for.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

UNUSED = "f2py"


def shorten() -> None:
    """Let SciPy be imported so, where it is as expected; what it computes is the same."""
    with _without_compiler():
        try:
            adapters: Any = importlib.import_module("scipy._lib._array_api")
        except ImportError:  # another SciPy
            return
    if hasattr(adapters, "FunctionDoc"):
        adapters.FunctionDoc = _Documentation


@contextmanager
def _without_compiler() -> Iterator[None]:
    """Meanwhile NumPy has a module without anything in place of its compiler."""
    name = f"{np.__name__}.{UNUSED}"
    if name in sys.modules:
        yield
        return
    np.__dict__[UNUSED] = sys.modules[name] = ModuleType(name)
    try:
        yield
    finally:
        del np.__dict__[UNUSED], sys.modules[name]


class _Documentation(dict[str, list[str]]):
    """The documentation of a function, to which nothing is added."""

    def __init__(self, function: Any) -> None:
        super().__init__()
        self._text: str = function.__doc__ or ""

    def __missing__(self, section: str) -> list[str]:
        return []

    def __str__(self) -> str:
        return f"\n{self._text}"  # SciPy drops the first line
