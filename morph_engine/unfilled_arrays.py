"""Device arrays that take memory only where something is written.

Taichi 1.7 fills every new array with zeros, and so all of its memory is taken at once. Arrays over
a whole grid of which a body reaches a part need far less.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from morph_engine.memory_limit import uncounted


@contextmanager
def unfilled() -> Iterator[None]:
    """Arrays made in here hold anything at first: read nothing of them that was not written."""
    from taichi.lang import impl

    runtime = impl.get_runtime()
    program = runtime.prog
    runtime.prog = _Unfilling(program)
    try:
        with uncounted():
            yield
    finally:
        runtime.prog = program


class _Unfilling:
    """The program, but for what it fills."""

    def __init__(self, program: Any) -> None:
        self._program = program

    def __getattr__(self, name: str) -> Any:
        return getattr(self._program, name)

    def create_ndarray(self, *arguments: Any, zero_fill: bool = False, **more: Any) -> Any:
        return self._program.create_ndarray(*arguments, zero_fill=False, **more)
