"""Runs a task in a child process with little memory and time: files can be hostile, work heavy.

A task is a module with a function `run`. The child, `child.py`, reads a line of JSON with its
arguments and limits from standard input, and writes lines of JSON to standard output: any number of
`{"progress": share}`, then `{"answer": value, "binary_bytes": n}` with n bytes behind it, or
`{"error": {"type", "cause", "remedy"}}`. It ends at once when its parent does.
"""

from __future__ import annotations

import json
import logging
import signal
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Any

from pydantic_core import to_json

from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.sandbox import landlock
from morph_engine.child_process import (
    describe_exit,
    environment_without_secrets,
    python_command,
)
from morph_engine.errors import ERRORS, MorphError, ResourceError, ResultError

MAX_THREADS = 4
"""Threads of a child's libraries; each of them reserves memory that the limit counts."""

OUT_OF_MEMORY = (b"bad_alloc", b"Resource temporarily unavailable")
"""What libraries say when they get no memory, or none for a thread."""

STDERR_TAIL_BYTES = 1 << 14
"""What is kept of a child's messages [bytes]."""

log: logging.Logger = logging.getLogger(__name__)


class CrashedError(ResultError):
    """A child has died in a way that it did not choose.

    Attributes:
        reason: How.
    """

    def __init__(self, subject: str, reason: str) -> None:
        super().__init__(f"{subject} failed unexpectedly ({reason}).", "Try again.")
        self.reason = reason


@dataclass(frozen=True)
class Limits:
    """What a child may take.

    Attributes:
        memory_bytes: Memory beyond that of the program itself [bytes].
        cpu_seconds: CPU time beyond that of the imports, summed over threads [s].
        file_bytes: Size of any file that it writes [bytes].
        threads: Threads of the libraries that it calls.
        reads: Files and folders that it reads, beside those of the program.
        writes: Files and folders that it may read and change.
    """

    memory_bytes: int
    cpu_seconds: int
    file_bytes: int = 0
    threads: int = 1
    reads: tuple[Path, ...] = ()
    writes: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Wording:
    """What a task does, in the words of a user.

    Attributes:
        subject: What it works on, as the beginning of a sentence: "The surface".
        verb: What it does with it, as the end of one: "compute".
        remedy: How it would take less memory and time.
    """

    subject: str
    verb: str
    remedy: str


@dataclass(frozen=True)
class Answer:
    """What a task returns.

    Attributes:
        value: Anything that JSON can hold.
        binary: Bytes that go with it.
    """

    value: Any = None
    binary: bytes = b""


class Computation:
    """A task that is to be run, or runs.

    Attributes:
        progress: Share that is done, from 0 to 1.
        cancelled: Whether it is to end, or not to begin.
    """

    def __init__(self) -> None:
        self.progress: float = 0.0
        self.cancelled: bool = False
        self._process: subprocess.Popen[bytes] | None = None

    def begin(self, process: subprocess.Popen[bytes]) -> None:
        """Note the process that computes it."""
        self._process = process
        if self.cancelled:
            process.kill()

    def cancel(self) -> None:
        """End it."""
        self.cancelled = True
        if self._process is not None:
            self._process.kill()


def run(
    task: str,
    arguments: Mapping[str, Any],
    limits: Limits,
    wording: Wording,
    computation: Computation,
) -> Answer:
    """Run a task to its end; blocks. It has a folder for temporary files, which goes with it.

    Args:
        task: Its module, whose function `run` is called.
        arguments: What it is called with, by name; anything that JSON can hold.
        limits: What it may take.
        wording: What it does.
        computation: Told of its child and of the share that is done.

    Returns:
        What the function returns.

    Raises:
        ResourceError: It has reached a limit, or was killed from outside.
        CrashedError: It has ended otherwise without an answer.
        MorphError: As the function raises it.
    """
    scratch = tempfile.TemporaryDirectory(prefix="morph-", ignore_cleanup_errors=True)
    limits = replace(
        limits,
        reads=(*limits.reads, landlock.list_of_fonts()),
        writes=(*limits.writes, Path(scratch.name)),
    )
    process = subprocess.Popen(
        python_command("chamfer_morph.worker.sandbox.child", task),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment_without_secrets() | _environment(limits) | _written_to(scratch.name),
        start_new_session=True,
    )
    assert process.stdin is not None and process.stderr is not None
    computation.begin(process)
    stderr_tail = bytearray()
    reader = threading.Thread(target=_read_tail, args=(process.stderr, stderr_tail), daemon=True)
    reader.start()
    late = threading.Event()
    alarm = threading.Timer(2 * limits.cpu_seconds + 10, _kill, (process, late))
    alarm.start()
    try:
        with process:
            with suppress(BrokenPipeError):  # it has died already; its status tells why
                process.stdin.write(to_json({"arguments": arguments, "limits": asdict(limits)}))
                process.stdin.write(b"\n")
                process.stdin.flush()  # it stays open, for the child ends with it
            answer = _read_answer(process, computation)
            status = process.wait()
            reader.join()
    finally:
        alarm.cancel()
        scratch.cleanup()
    if late.is_set() or -status == signal.SIGXCPU:
        raise _too_much(wording, f"{limits.cpu_seconds} s")
    no_memory = any(words in stderr_tail for words in OUT_OF_MEMORY)
    if status == ExitCode.OUT_OF_MEMORY or (status and no_memory):
        raise _too_much(wording, f"{limits.memory_bytes >> 20} MiB of memory")
    if -status == signal.SIGKILL:
        raise ResourceError(
            f"{wording.subject} is not available because its process was killed from outside.",
            "Try again; if it is killed again, the machine probably has too little memory.",
        )
    if status or answer is None:
        how = describe_exit(status)
        log.warning("%s: %s: %s", task, how, stderr_tail.decode(errors="replace"))
        raise CrashedError(wording.subject, how)
    if isinstance(answer, MorphError):
        raise answer
    return answer


def _written_to(folder: str) -> dict[str, str]:
    """The one folder of a child for temporary files, and for a list of fonts where there is none.

    The list that Matplotlib keeps for this user is read, and nothing is added to it.
    """
    for kept in landlock.list_of_fonts().glob("fontlist*.json"):
        Path(folder, kept.name).symlink_to(kept)
    return {"TMPDIR": folder, "MPLCONFIGDIR": folder}


def _environment(limits: Limits) -> dict[str, str]:
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS")
    return dict.fromkeys(names, str(limits.threads)) | {"MALLOC_ARENA_MAX": "2"}


def _read_answer(
    process: subprocess.Popen[bytes], computation: Computation
) -> Answer | MorphError | None:
    """What a child answers, or the error it raises; None where it dies before."""
    assert process.stdout is not None
    answer: Answer | MorphError | None = None
    with suppress(ValueError):  # it died within a line
        for line in process.stdout:
            match json.loads(line):
                case {"progress": share}:
                    computation.progress = share
                case {"answer": value, "binary_bytes": size}:
                    answer = Answer(value, process.stdout.read(size))
                case {"error": {"type": name, "cause": cause, "remedy": remedy}}:
                    answer = ERRORS.get(name, MorphError)(cause, remedy)
    return answer


def _too_much(wording: Wording, amount: str) -> ResourceError:
    cause = f"{wording.subject} takes more than {amount} to {wording.verb}."
    return ResourceError(cause, wording.remedy)


def _read_tail(stream: IO[bytes], tail: bytearray) -> None:
    """Keep the end of what a child writes, so that it never waits for a reader."""
    while read := stream.read1(STDERR_TAIL_BYTES):  # type: ignore[attr-defined]
        tail += read
        del tail[:-STDERR_TAIL_BYTES]


def _kill(process: subprocess.Popen[bytes], late: threading.Event) -> None:
    late.set()
    process.kill()
