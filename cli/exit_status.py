"""How a command ends: its exit status, and what a user reads when something is wrong."""

from __future__ import annotations

import os
import platform
import sys
import traceback
from collections.abc import Callable
from importlib import metadata

import typer

from chamfer_morph.cli.output import error_document, in_flags, print_json
from morph_engine.errors import MorphError
from morph_engine.memory_limit import is_out_of_memory

UNEXPECTED, BAD_INPUT = 1, 2
JOB_FAILED = 1


def exit_status(command: Callable[[], int | None], *, as_json: bool, debug: bool) -> int:
    """Run a command to its exit status; whatever it raises becomes a message, not a traceback.

    It is 0, or 2 for input a user can mend, 3 without the service, 1 for a fault of the program,
    which `debug` lets through. With `as_json` errors go to standard output, too.
    """
    problem: MorphError
    try:
        return command() or 0
    except MorphError as error:
        # `ServiceError` knows its own; the extra `client`, which has it, may be absent
        problem, status = error, getattr(error, "exit_status", BAD_INPUT)
    except typer.TyperException as error:
        problem, status = _usage_error(error), BAD_INPUT
    except BrokenPipeError:
        # whoever read our output has enough; keep the interpreter's last flush quiet
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if is_out_of_memory(error):
            problem, status = _no_memory(), BAD_INPUT
        elif debug:
            raise
        else:
            problem, status = _program_fault(error), UNEXPECTED
    if as_json:
        print_json(error_document(problem))
    sys.stderr.write(f"{problem.cause}\n{in_flags(problem.remedy)}\n")
    return status


def _usage_error(error: typer.TyperException) -> MorphError:
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "morph"
    return MorphError(f"{error.format_message().rstrip('.')}.", f"See {command} --help.")


def _no_memory() -> MorphError:
    return MorphError(
        "There is not enough memory for this.",
        "Use fewer points per cell edge, or free memory.",
    )


def _program_fault(error: Exception) -> MorphError:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    location = f"{os.path.basename(frame.filename)}, line {frame.lineno}"
    version = metadata.version("chamfer-morph")
    return MorphError(
        f"This is a bug in morph: {type(error).__name__}: {error} in {location}.",
        f"Please report that line, your command, chamfer-morph {version}, Python "
        f"{platform.python_version()} and {platform.platform()}; --debug shows the traceback.",
    )
