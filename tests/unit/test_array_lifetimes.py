"""Arrays of a Taichi program that has ended take none of the next one along."""

import taichi as ti

from morph_engine import backend
from morph_engine.array_lifetimes import begin_program, guard


def test_arrays_are_deleted_by_the_program_that_made_them_alone() -> None:
    """One that outlives its program is left alone at its end, one that does not is deleted."""
    deleted = []

    class Array:
        def __init__(self, name: str) -> None:
            self.name = name

        def __del__(self) -> None:
            deleted.append(self.name)

    guard(Array)
    first, second = Array("first"), Array("second")
    del first
    begin_program()
    del second
    third = Array("third")
    del third
    assert deleted == ["first", "third"]


def test_device_arrays_know_their_program() -> None:
    """Arrays that Taichi deletes, and packs of arrays, of the program that runs."""
    numbers = backend.active().scalars(4)
    pack = ti.types.argpack(numbers=ti.types.ndarray())(numbers=numbers)
    assert numbers._program == pack._program > 0
