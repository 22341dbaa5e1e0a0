"""Child processes with little memory and time: files can be hostile, and some work is heavy.

A child is `python -m MODULE ARGUMENT...`; it calls `enter` once its imports are done. What it
prints is its answer, and where it runs out of memory it exits with `OUT_OF_MEMORY`. It ends at once
when its parent does.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import psutil

from morph_engine.errors import ResourceError, ResultError

ORPHANED, OUT_OF_MEMORY = 75, 77
MOST_THREADS = 4
"""Threads of a child's libraries; each of them reserves memory that the limit counts."""

_LIMITS = "MORPH_LIMITS"


class TooMuchMemory(Exception):
    """A child has reached its limit of memory."""


class TooMuchTime(Exception):
    """A child has reached its limit of time."""


class Broken(Exception):
    """A child has died in a way that it did not choose; the message says how."""


@dataclass(frozen=True)
class Limits:
    """What a child may take.

    Attributes:
        memory_bytes: Memory beyond that of the program itself [bytes].
        cpu_seconds: CPU time, summed over threads [s].
        file_bytes: Size of any file that it writes [bytes].
        threads: Threads of the libraries that it calls.
    """

    memory_bytes: int
    cpu_seconds: int
    file_bytes: int = 0
    threads: int = 1


def run(
    module: str,
    arguments: Sequence[str],
    limits: Limits,
    *,
    hear: Callable[[bytes], None] | None = None,
    meet: Callable[[subprocess.Popen[bytes]], None] | None = None,
) -> bytes:
    """Run a child to its end; blocks.

    Args:
        module: The module to run.
        arguments: Its command line.
        limits: What it may take.
        hear: Called with each line of its answer as it comes, instead of returning the answer.
        meet: Called with the process once it has started.

    Returns:
        What it printed, empty where `hear` has had it.

    Raises:
        TooMuchMemory, TooMuchTime: It has reached a limit.
        Broken: It has ended otherwise than with status 0.
    """
    threads = str(limits.threads)
    environment = os.environ | {
        "OMP_NUM_THREADS": threads,
        "OPENBLAS_NUM_THREADS": threads,
        "RAYON_NUM_THREADS": threads,
        "MALLOC_ARENA_MAX": "2",
        _LIMITS: f"{limits.memory_bytes} {limits.cpu_seconds} {limits.file_bytes}",
    }
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=said,
            env=environment,
            start_new_session=True,
        )
        if meet is not None:
            meet(process)
        late = threading.Event()
        alarm = threading.Timer(2 * limits.cpu_seconds + 10, _end, (process, late))
        alarm.start()
        try:
            with process:
                assert process.stdout is not None
                if hear is None:
                    answer = process.stdout.read()
                else:
                    answer = b""
                    for line in process.stdout:
                        hear(line)
                status = process.wait()
        finally:
            alarm.cancel()
        said.seek(0)
        last_words = said.read()
    if late.is_set() or -status in (signal.SIGXCPU, signal.SIGKILL):
        raise TooMuchTime
    if status == OUT_OF_MEMORY or (status and b"bad_alloc" in last_words):
        raise TooMuchMemory
    if status:
        raise Broken(signal.Signals(-status).name if status < 0 else f"exit status {status}")
    return answer


@contextmanager
def explaining(what: str, limits: Limits) -> Iterator[None]:
    """Tell a user of what a child has run into.

    Args:
        what: What it computes, as the beginning of a sentence.
        limits: Its limits.

    Raises:
        ResourceError: It takes too much memory or time.
        ResultError: It has died.
    """
    remedy = "Run the job with fewer points per cell edge, or ask for less at a time."
    try:
        yield
    except TooMuchTime:
        raise ResourceError(
            f"{what} takes more than {limits.cpu_seconds} s to compute.", remedy
        ) from None
    except TooMuchMemory:
        raise ResourceError(
            f"{what} takes more than {limits.memory_bytes >> 20} MiB of memory.", remedy
        ) from None
    except Broken as how:
        raise ResultError(f"{what} could not be computed ({how}).", "Try it again.") from None


def enter() -> None:
    """Take on the limits that `run` has set, and end with the parent.

    Memory that the process has by now is free, so import first what the work needs.
    """
    threading.Thread(target=_end_with_parent, daemon=True).start()
    memory, seconds, file_bytes = map(int, os.environ[_LIMITS].split())
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    if sys.platform != "darwin":  # which does not enforce it
        memory += psutil.Process().memory_info().vms
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def _end(process: subprocess.Popen[bytes], late: threading.Event) -> None:
    late.set()
    process.kill()


def _end_with_parent() -> None:
    while os.read(0, 1):
        pass
    os._exit(ORPHANED)
