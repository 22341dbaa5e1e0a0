"""The child process of `runner.run`, with the module of the task as its argument."""

from __future__ import annotations

import importlib
import inspect
import json
import os
import sys
from typing import Any

import psutil
from pydantic import validate_call
from pydantic_core import to_json

from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.sandbox.runner import Answer, Limits
from morph_engine.child_process import exit_with_parent
from morph_engine.errors import MorphError

ENGINE_IMPORTS = ("igl", "scipy.spatial", "scipy.sparse.csgraph", "morph_engine.geometry.text")
"""What the engine imports when it first needs it: memory of the program, not of a task."""


class Channel:
    """The way back to the parent: standard output, on which nobody else writes from now on."""

    def __init__(self) -> None:
        self._stream = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)

    def report_progress(self, share: float) -> None:
        """Tell how far the task has come, from 0 to 1."""
        self._send(progress=share)

    def fail(self, error: MorphError) -> None:
        """Tell why it cannot be done."""
        kind = type(error).__name__
        self._send(error={"type": kind, "cause": error.cause, "remedy": error.remedy})

    def answer(self, answer: Answer) -> None:
        """Tell what has come of it."""
        self._send(answer=answer.value, binary_bytes=len(answer.binary))
        self._stream.write(answer.binary)
        self._stream.flush()

    def _send(self, **message: Any) -> None:
        self._stream.write(to_json(message) + b"\n")
        self._stream.flush()


def main(module: str) -> None:
    """Run a task within limits; memory that the program has before it begins is free."""
    request = json.loads(sys.stdin.buffer.readline())
    exit_with_parent(ExitCode.ORPHANED)
    channel = Channel()
    function = importlib.import_module(module).run
    for name in ENGINE_IMPORTS:
        importlib.import_module(name)
    arguments = request["arguments"]
    if "report_progress" in inspect.signature(function).parameters:
        arguments["report_progress"] = channel.report_progress
    enforce(Limits(**request["limits"]))
    try:
        answer = validate_call(function)(**arguments)
        channel.answer(answer if isinstance(answer, Answer) else Answer(answer))
    except MemoryError:
        sys.exit(ExitCode.OUT_OF_MEMORY)
    except MorphError as error:
        channel.fail(error)


def enforce(limits: Limits) -> None:
    """Take on limits, where the system knows them."""
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_bytes, limits.file_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_seconds, limits.cpu_seconds + 1))
    if sys.platform != "darwin":  # which does not enforce it
        memory = limits.memory_bytes + psutil.Process().memory_info().vms
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


if __name__ == "__main__":
    main(sys.argv[1])
