"""The child process of `runner.run`, with the module of the task as its argument."""

from __future__ import annotations

import importlib
import inspect
import json
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import psutil
from pydantic import validate_call
from pydantic_core import to_json

from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.sandbox import landlock
from chamfer_morph.worker.sandbox.network import leave_network
from chamfer_morph.worker.sandbox.runner import Answer, Limits
from morph_engine.child_process import exit_with_parent, keep_output
from morph_engine.errors import MorphError

ENGINE_IMPORTS = ("igl", "scipy.spatial", "scipy.sparse.csgraph")
"""What the engine imports when it first needs it: memory of the program, not of a task."""


def main(module: str) -> None:
    """Run a task within limits; memory and time of the program before it begins are free.

    It has no network, and of the files those alone that the program and the task need, where the
    system allows to take the rest.
    """
    leave_network()
    request = json.loads(sys.stdin.buffer.readline())
    limits = Limits(**request["limits"])
    landlock.confine(map(Path, limits.reads), map(Path, limits.writes))
    exit_with_parent(ExitCode.ORPHANED)
    channel = os.fdopen(keep_output(), "wb")

    def send(message: dict[str, Any], binary: bytes = b"") -> None:
        channel.write(to_json(message) + b"\n" + binary)
        channel.flush()

    function = importlib.import_module(module).run
    for name in ENGINE_IMPORTS:
        importlib.import_module(name)
    arguments = request["arguments"]
    if "report_progress" in inspect.signature(function).parameters:
        arguments["report_progress"] = lambda share: send({"progress": share})
    enforce(limits)
    try:
        answer = validate_call(function)(**arguments)
        if not isinstance(answer, Answer):
            answer = Answer(answer)
        send({"answer": answer.value, "binary_bytes": len(answer.binary)}, answer.binary)
    except MemoryError:
        sys.exit(ExitCode.OUT_OF_MEMORY)
    except MorphError as error:
        kind = type(error).__name__
        send({"error": {"type": kind, "cause": error.cause, "remedy": error.remedy}})


def enforce(limits: Limits) -> None:
    """Take on limits, where the system knows them."""
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_bytes, limits.file_bytes))
    seconds = limits.cpu_seconds + math.ceil(time.process_time())
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    if sys.platform != "darwin":  # which does not enforce it
        memory = limits.memory_bytes + psutil.Process().memory_info().vms
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


if __name__ == "__main__":
    main(sys.argv[1])
