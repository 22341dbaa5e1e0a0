"""Device arrays on a CPU are copied to and from the host as the memory that they are.

Taichi 1.7 copies every array by a kernel, element by element, which takes several times as long.
"""

from __future__ import annotations

import ctypes
from typing import Any

import lazy_loader as lazy
import numpy as np
from numpy.typing import NDArray

ti: Any = lazy.load("taichi")

_shortened = False


def shorten() -> None:
    """Let arrays copy themselves so while Taichi runs on a CPU, where it is as expected."""
    global _shortened
    program = ti.lang.impl.get_runtime().prog
    if _shortened or not hasattr(program, "get_ndarray_data_ptr_as_int"):
        return
    _shortened = True
    lang = ti.lang
    for kind in (lang._ndarray.ScalarNdarray, lang.matrix.VectorNdarray, lang.matrix.MatrixNdarray):
        _shorten(kind)


def _shorten(kind: Any) -> None:
    to_numpy, from_numpy = kind.to_numpy, kind.from_numpy

    def to_host(self: Any) -> NDArray[Any]:
        return memory(self).copy() if _copies_memory(self) else to_numpy(self)

    def from_host(self: Any, values: NDArray[Any]) -> None:
        if _copies_memory(self) and getattr(values, "shape", None) == _shape(self):
            memory(self)[...] = values
        else:
            from_numpy(self, values)  # which says what is wrong

    kind.to_numpy, kind.from_numpy = to_host, from_host


def copy_to_front(array: Any, values: NDArray[Any]) -> None:
    """Copy to the first elements of a device array; what the others hold has no meaning then."""
    if _shortened and _copies_memory(array):
        memory(array)[: len(values)] = values
    else:
        padded = np.zeros(_shape(array), ti.lang.util.to_numpy_type(array.dtype))
        padded[: len(values)] = values
        array.from_numpy(padded)


def copy_of_front(array: Any, count: int) -> NDArray[Any]:
    """The first elements of a device array, so many."""
    if _shortened and _copies_memory(array):
        return memory(array)[:count].copy()
    front: NDArray[Any] = array.to_numpy()[:count]
    return front


def memory(array: Any) -> NDArray[Any]:
    """The memory of a device array on a CPU: valid as long as the array is."""
    program = ti.lang.impl.get_runtime().prog
    program.synchronize()
    shape, kind = _shape(array), np.dtype(ti.lang.util.to_numpy_type(array.dtype))
    size = int(np.prod(shape)) * kind.itemsize
    address = program.get_ndarray_data_ptr_as_int(array.arr)
    buffer = (ctypes.c_char * size).from_address(address)
    return np.frombuffer(buffer, kind).reshape(shape)


def _shape(array: Any) -> tuple[int, ...]:
    return tuple(array.arr.total_shape())


def _copies_memory(array: Any) -> bool:
    return bool(ti.lang.impl.current_cfg().arch in (ti.x64, ti.arm64) and array.arr.nelement())
