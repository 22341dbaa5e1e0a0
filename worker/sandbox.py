"""Child processes with little memory and time: files can be hostile, and some work is heavy.

A child is `python -m MODULE ARGUMENT...`; it calls `enter` once its imports are done. What it
prints is its answer, and where it runs out of memory it exits with `ExitCode.OUT_OF_MEMORY`. It
ends at once when its parent does.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO

import psutil

from chamfer_morph.worker.exit_codes import ExitCode
from morph_engine.child_process import exit_with_parent, python_command
from morph_engine.errors import ResourceError, ResultError

MOST_THREADS = 4
"""Threads of a child's libraries; each of them reserves memory that the limit counts."""

LAST_WORDS = 1 << 14
"""What is kept of a child's messages [bytes]."""

_LIMITS = "MORPH_LIMITS"
log = logging.getLogger(__name__)


class TooMuchMemory(Exception):
    """A child has reached its limit of memory."""


class TooMuchTime(Exception):
    """A child has reached its limit of time."""


class Killed(Exception):
    """A child was ended from outside, as by a machine that has no memory left."""


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
        Killed: Somebody else has ended it.
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
    process = subprocess.Popen(
        python_command(module, *arguments),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        start_new_session=True,
    )
    assert process.stdout is not None and process.stderr is not None
    if meet is not None:
        meet(process)
    last_words = bytearray()
    listener = threading.Thread(target=_listen, args=(process.stderr, last_words), daemon=True)
    listener.start()
    late = threading.Event()
    alarm = threading.Timer(2 * limits.cpu_seconds + 10, _end, (process, late))
    alarm.start()
    try:
        with process:
            if hear is None:
                answer = process.stdout.read()
            else:
                answer = b""
                for line in process.stdout:
                    hear(line)
            status = process.wait()
            listener.join()
    finally:
        alarm.cancel()
    if late.is_set() or -status == signal.SIGXCPU:
        raise TooMuchTime
    if status == ExitCode.OUT_OF_MEMORY or (status and b"bad_alloc" in last_words):
        raise TooMuchMemory
    if -status == signal.SIGKILL:
        raise Killed
    if status:
        how = signal.Signals(-status).name if status < 0 else f"exit status {status}"
        log.warning("%s: %s: %s", module, how, last_words.decode(errors="replace"))
        raise Broken(how)
    return answer


@contextmanager
def explaining(what: str, to_do: str, limits: Limits, remedy: str) -> Iterator[None]:
    """Tell a user of what a child has run into.

    Args:
        what: What it works on, as the beginning of a sentence.
        to_do: What it does with it, as the end of one.
        limits: Its limits.
        remedy: How it would take less.

    Raises:
        ResourceError: It takes too much memory or time.
        ResultError: It has died otherwise.
    """
    try:
        yield
    except TooMuchTime:
        cause = f"{what} takes more than {limits.cpu_seconds} s to {to_do}."
        raise ResourceError(cause, remedy) from None
    except TooMuchMemory:
        cause = f"{what} takes more than {limits.memory_bytes >> 20} MiB of memory to {to_do}."
        raise ResourceError(cause, remedy) from None
    except Killed:
        raise ResourceError(
            f"{what} is not there, because its process was killed from outside.",
            "Ask again; if it is killed again, the machine has too little memory.",
        ) from None
    except Broken as how:
        raise ResultError(f"{what} has broken off ({how}).", "Try it again.") from None


def enter() -> None:
    """Take on the limits that `run` has set, and end with the parent.

    Memory that the process has by now is free, so import first what the work needs.
    """
    exit_with_parent(ExitCode.ORPHANED)
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


def _listen(stream: IO[bytes], last_words: bytearray) -> None:
    """Keep the end of what a child says, and keep it from waiting for a listener."""
    while said := stream.read1(LAST_WORDS):  # type: ignore[attr-defined]
        last_words += said
        del last_words[:-LAST_WORDS]


def _end(process: subprocess.Popen[bytes], late: threading.Event) -> None:
    late.set()
    process.kill()
