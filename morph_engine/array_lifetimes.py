"""Device arrays end with the Taichi program that made them.

When an array is collected, Taichi 1.7 has it deleted by the program that runs by then, which knows
it by its address alone. After a restart that can be the address of another array, whose memory
would be gone. Here an array is deleted only by the program that made it; those of a program that
has ended are gone with it.
"""

from __future__ import annotations

from typing import Any

import lazy_loader as lazy

ti: Any = lazy.load("taichi")

_programs: int = 0
"""Taichi programs begun so far."""


def begin_program() -> None:
    """Note that Taichi starts again: arrays made so far are no longer to be deleted."""
    global _programs
    if not _programs:
        guard(ti.lang._ndarray.ScalarNdarray)
        guard(ti.lang.argpack.ArgPack)
    _programs += 1


def guard(kind: Any) -> None:
    """Let instances of a class do what they do at their end only in the program they began in."""
    begin, end = kind.__init__, kind.__del__

    def __init__(self: Any, *arguments: Any, **more: Any) -> None:
        self._program = _programs
        begin(self, *arguments, **more)

    def __del__(self: Any) -> None:
        if getattr(self, "_program", None) == _programs:
            end(self)

    kind.__init__, kind.__del__ = __init__, __del__
