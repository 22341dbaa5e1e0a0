"""A child with little memory that makes a file beside a job, and prints why if it could not."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from chamfer_morph.worker import sandbox
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.settings import Settings
from morph_engine.errors import MorphError, ResultError


@dataclass(frozen=True)
class Making:
    """What a child makes, in the words of a user.

    Attributes:
        what: The beginning of a sentence: "The surface".
        to_do: The end of one: "compute".
        remedy: How it would take less memory and time.
    """

    what: str
    to_do: str
    remedy: str


def make_file(
    module: str,
    arguments: Sequence[str],
    making: Making,
    settings: Settings,
    *,
    threads: int = 1,
    meet: Callable[[subprocess.Popen[bytes]], None] | None = None,
) -> None:
    """Run a child that makes a file; blocks.

    Args:
        module: The module to run; it works within `saying_why`.
        arguments: Its command line.
        making: What it makes.
        settings: Memory and CPU time that it may take.
        threads: Threads of the libraries that it calls.
        meet: Called with the child.

    Raises:
        ResultError: It says why it could not, or has broken off.
        ResourceError: It takes too much memory or time.
    """
    limits = sandbox.Limits(
        settings.export_memory_bytes,
        settings.export_cpu_seconds,
        file_bytes=settings.export_memory_bytes,
        threads=threads,
    )
    with sandbox.explaining(making.what, making.to_do, limits, making.remedy):
        said = sandbox.run(module, arguments, limits, meet=meet)
    if said:
        raise ResultError(**json.loads(said))


@contextmanager
def saying_why(making: Making) -> Iterator[None]:
    """Work in a child; what goes wrong is printed."""
    try:
        yield
    except MemoryError:
        sys.exit(ExitCode.OUT_OF_MEMORY)
    except OSError as error:
        reason = error.strerror or error
        _say(
            f"{making.what} cannot be written ({reason}).",
            "Free some disk space, and see that the job has not been deleted.",
        )
    except MorphError as error:
        _say(error.cause, error.remedy)


def _say(cause: str, remedy: str) -> None:
    sys.stdout.write(json.dumps({"cause": cause, "remedy": remedy}))
