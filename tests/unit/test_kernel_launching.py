"""A launch that a kernel remembers does what a first one does."""

import gc
from collections.abc import Iterator

import numpy as np
import pytest
import taichi as ti

from morph_engine import backend

Pair = ti.types.argpack(a=ti.types.ndarray(), b=ti.types.ndarray())


@ti.kernel
def fill(out: ti.types.ndarray(), value: float, times: int, negative: bool):
    """Give all elements one value."""
    for i in range(out.shape[0]):
        out[i] = value * times * (-1 if negative else 1)


@ti.kernel
def add(out: ti.types.ndarray(), pair: Pair, power: ti.template()) -> float:
    """Two arrays of a pack, and the sum of what comes out."""
    total = 0.0
    for i in range(out.shape[0]):
        out[i] = pair.a[i] ** power + pair.b[i]
        total += out[i]
    return total


@pytest.fixture(autouse=True)
def on_the_cpu() -> Iterator[None]:
    """Kernels remember their launches on every device; the CPU is always there."""
    backend.start("cpu", threads=2)
    yield


def test_numbers_differ_from_launch_to_launch() -> None:
    """Each launch uses its own."""
    out = backend.active().scalars(3)
    for value, times, negative in ((1.5, 2, False), (2.5, 3, True), (1.5, 2, False)):
        fill(out, value, times, negative)
        assert (out.to_numpy() == value * times * (-1 if negative else 1)).all()


def test_members_of_a_pack_may_be_exchanged() -> None:
    """A pack whose arrays change, as layers of a simulation do, is not the one of before."""
    device = backend.active()
    one, two, out = (device.upload(np.full(4, value)) for value in (1.0, 2.0, 0.0))
    pair = Pair(a=one, b=two)
    assert [add(out, pair, 2), add(out, pair, 2)] == [12, 12]
    pair["a"], pair["b"] = two, one
    assert [add(out, pair, 2), add(out, pair, 2)] == [20, 20]
    assert [add(out, pair, 3), add(out, pair, 3)] == [36, 36]
    assert (out.to_numpy() == 9).all()


def test_an_array_that_is_gone_is_not_used() -> None:
    """A new array may get its place in memory, and its identity in Python."""
    for value in range(100):
        out = backend.active().scalars(7)
        fill(out, value, 1, False)
        assert (out.to_numpy() == value).all()
        del out
        gc.collect()


def test_another_start_of_taichi_is_another_program() -> None:
    """What a kernel remembers ends with the program that it was launched in."""
    for threads in (1, 2, 1):
        backend.start("cpu", threads=threads)
        out = backend.active().scalars(5)
        for value in (1, 2):
            fill(out, value, 1, False)
            assert (out.to_numpy() == value).all()


def test_host_arrays_are_taken_as_they_are() -> None:
    """A NumPy array is not on the device: each launch has its own values."""
    for value in (1.0, 2.0):
        out = np.zeros(3, np.float32)
        fill(out, value, 1, False)
        assert (out == value).all()


@pytest.mark.parametrize("width", [1, 3, 9])
def test_arrays_come_back_as_they_went(width: int) -> None:
    """Copies of scalars, vectors and matrices are the values, and not the array's own memory."""
    device = backend.active()
    values = np.random.default_rng(width).normal(size=(5, width)).astype(np.float32)
    values = values.reshape({1: (5,), 3: (5, 3), 9: (5, 3, 3)}[width])
    array = device.upload(values)
    copy = array.to_numpy()
    array.from_numpy(np.zeros_like(values))
    assert (copy == values).all()
    assert not array.to_numpy().any()
    with pytest.raises(ValueError, match="shape"):
        array.from_numpy(values[:4])
