"""The one place that starts Taichi: device, precision, threads and array allocation.

Kernels everywhere else are module-level functions over `ti.ndarray` arguments, so one compilation
serves every particle count and is kept in Taichi's offline cache between processes.

Two execution styles share each scattering kernel:

* on a CPU a fixed number of chunks, each serial and with private memory, reduced in a fixed order:
  no atomics, and results do not depend on the number of threads;
* on a GPU one chunk per item and atomic additions.
"""

from __future__ import annotations

import contextlib
import functools
import io
import operator
import os
import time
from collections.abc import Iterator
from ctypes.util import find_library
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import lazy_loader as lazy
import numpy as np
from numpy.typing import NDArray

from morph_engine import array_copies, array_lifetimes, kernel_launching, kernel_loading
from morph_engine.device import Device
from morph_engine.errors import ConfigError, DeviceError
from morph_engine.pinned_threads import pinned
from morph_engine.system_libraries import require_libraries

ti: Any = lazy.load("taichi")  # which takes a second; not every use of the package computes

Precision = Literal["float32", "float64"]

# Taichi 1.7 runs a CPU loop of up to 512 iterations on one thread, so chunk c is iteration c * 512.
CPU_CHUNK_STRIDE = 512
CPU_CHUNK_COUNT = 8

MOST_THREADS = 1024
"""CPU threads that may be asked for; many more would leave the machine none for anything else."""

LOCK_SECONDS = 60.0
"""Taichi locks its offline cache for a fraction of a second; a lock this old is of a dead process,
and nothing would be read from the cache any more, nor written to it."""


@dataclass(frozen=True)
class Backend:
    """What Taichi was started with: device (never "auto"), CPU threads (0: all) and precision."""

    device: str
    threads: int
    precision: Precision

    @property
    def on_cpu(self) -> bool:
        """Whether kernels run on the CPU, in chunks and without atomics."""
        return self.device == "cpu"

    @property
    def real(self) -> Any:
        """The Taichi type of every real number on the device."""
        return ti.f64 if self.precision == "float64" else ti.f32

    @property
    def numpy_real(self) -> type[np.floating[Any]]:
        """The NumPy type of every real number on the device."""
        return np.float64 if self.precision == "float64" else np.float32

    @property
    def in_words(self) -> str:
        """The settings in words."""
        threads = f"{self.threads} threads" if self.threads else "all threads"
        return f"{self.device}, {threads} and {self.precision}"

    def scalars(self, count: int) -> Any:
        """A zeroed device array of reals, shape [count]."""
        return ti.ndarray(self.real, count)

    def integers(self, count: int) -> Any:
        """A zeroed device array of int32, shape [count]."""
        return ti.ndarray(ti.i32, count)

    def integer_vectors(self, count: int, width: int) -> Any:
        """A zeroed device array of int32 vectors, shape [count, width]."""
        return ti.Vector.ndarray(width, ti.i32, count)

    def vectors(self, count: int, width: int = 3) -> Any:
        """A zeroed device array of real vectors, shape [count, width]."""
        return ti.Vector.ndarray(width, self.real, count)

    def matrices(self, count: int) -> Any:
        """A zeroed device array of real 3x3 matrices, shape [count, 3, 3]."""
        return ti.Matrix.ndarray(3, 3, self.real, count)

    def upload(self, values: NDArray[Any]) -> Any:
        """Copy a host array, shape [n], [n, w] or [n, 3, 3], to a new device array of reals.

        Taichi 1.7 keeps the memory of device arrays on a CPU to the end of the process: make those
        of a frame once, and fill them again.
        """
        array = {1: self.scalars, 2: self.vectors, 3: self.matrices}[values.ndim](
            *((len(values), values.shape[1]) if values.ndim == 2 else (len(values),))
        )
        array.from_numpy(np.ascontiguousarray(values, dtype=self.numpy_real))
        return array


_active: Backend | None = None
_process = 0  # that Taichi runs in
_runs: set[object] = set()  # in progress, each with device arrays


def start(
    device: Device = "auto", *, threads: int = 0, precision: Precision = "float32"
) -> Backend:
    """Start Taichi, or keep it when it already runs with the same settings.

    Restarting with other settings invalidates every device array made before, so that it is
    refused while a run is in progress.

    Args:
        device: "auto" takes CUDA, then Metal on a Mac, then the CPU.
        threads: CPU threads, at most MOST_THREADS; 0 takes every core.
        precision: Type of every real number on the device.

    Raises:
        ConfigError: There cannot be so many threads.
        DeviceError: The device is not available, or cannot compute in this precision; or Taichi
            cannot be loaded on this system, was started before this process was forked, or is in
            use with other settings.
    """
    global _active, _process
    threads = _checked_threads(threads)
    require_libraries()
    kernel_loading.shorten()
    wanted = Backend(_choose(device), threads, precision)
    if _active and _process != os.getpid():
        raise DeviceError(
            "This process was forked from one in which Taichi runs, and cannot compute.",
            "Start it by spawning: multiprocessing.get_context('spawn').",
        )
    if wanted == _active:
        return wanted
    if _active and _runs:
        raise DeviceError(
            f"Another morph in this process is in progress, with {_active.in_words}; this one asks "
            f"for {wanted.in_words}.",
            "Finish or close the other one first, or use the same settings for both.",
        )
    if precision == "float64" and wanted.device in ("metal", "vulkan"):
        raise DeviceError(
            f"The device {wanted.device} does not support float64.",
            "Set `device` to cpu or cuda, or use float32.",
        )
    array_lifetimes.begin_program()
    kernel_launching.forget()
    _remove_old_lock(kernel_folder())
    options: dict[str, Any] = {"cpu_max_num_threads": threads} if threads else {}
    pinning = pinned(threads) if wanted.on_cpu else contextlib.nullcontext()
    with contextlib.redirect_stdout(io.StringIO()), pinning:  # Taichi announces itself on stdout
        ti.init(
            arch=getattr(ti, wanted.device),
            default_fp=wanted.real,
            default_ip=ti.i32,
            offline_cache=True,
            fast_math=False,  # keeps NaN tests meaningful, and gains nothing here
            log_level=ti.ERROR,
            **options,
        )
    array_copies.shorten()
    kernel_launching.shorten()
    _active, _process = wanted, os.getpid()
    return wanted


@contextlib.contextmanager
def in_use() -> Iterator[None]:
    """Keep Taichi as it is meanwhile: a run has arrays on the device."""
    run = object()
    _runs.add(run)
    try:
        yield
    finally:
        _runs.discard(run)


def end() -> None:
    """End Taichi, if it runs, which then writes the kernels that it has compiled to its cache.

    For processes that end at once; it invalidates every device array.
    """
    global _active
    if _active:
        _active = None
        array_lifetimes.begin_program()
        kernel_launching.forget()
        ti.reset()


def active() -> Backend:
    """The running backend; starts the default one when none runs yet."""
    return _active or start()


def runs_on_cpu() -> bool:
    """Whether Taichi runs by now, and on the CPU."""
    return _active is not None and _active.on_cpu


def available_devices() -> tuple[str, ...]:
    """Devices that Taichi can start on this machine, best first."""
    return tuple(name for name in ("cuda", "metal", "vulkan", "cpu") if _is_available(name))


@functools.cache
def _is_available(name: str) -> bool:
    # Taichi logs a warning when asked about CUDA without its driver library, so look first.
    if name == "cuda" and find_library("cuda") is None:
        return False
    return bool(ti.lang.misc.is_arch_supported(getattr(ti, name)))


def kernel_folder() -> Path:
    """Where Taichi keeps compiled kernels between processes."""
    named = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH")
    return Path(named or ti.lang.impl.default_cfg().offline_cache_file_path)


def _checked_threads(threads: int) -> int:
    try:
        count = operator.index(threads)
    except TypeError:
        count = -1
    if not 0 <= count <= MOST_THREADS:
        raise ConfigError(
            f"There cannot be {threads!r} CPU threads.",
            f"Set `threads` to 1 to {MOST_THREADS}, or to 0 for every core.",
        )
    return count


def _remove_old_lock(cache: Path) -> None:
    """Unlock a cache that a process has locked and never unlocked, as it was killed."""
    lock = cache / "ticache.lock"
    with contextlib.suppress(OSError):
        if time.time() - lock.stat().st_mtime > LOCK_SECONDS:
            lock.unlink()


def _choose(device: str) -> str:
    if device == "auto":
        return next(name for name in ("cuda", "metal", "cpu") if _is_available(name))
    if device not in ("cpu", "cuda", "vulkan", "metal"):
        raise DeviceError(
            f"There is no device called {device!r}.",
            "Choose one of auto, cpu, cuda, vulkan, metal.",
        )
    if not _is_available(device):
        raise DeviceError(
            f"The device {device} is not available on this machine.",
            f"Choose one of {', '.join(available_devices())}, or auto.",
        )
    return device
