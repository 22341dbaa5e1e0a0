"""How a command ends: its exit status, and what a user reads when something is wrong."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable
from importlib import metadata

import typer

from morph_engine.errors import MorphError

UNEXPECTED, BAD_INPUT, INTERRUPTED = 1, 2, 130


def exit_status(command: Callable[[], int | None], *, as_json: bool, debug: bool) -> int:
    """Run a command to its exit status; whatever it raises becomes a message, not a traceback.

    Args:
        command: The command; returns its exit status, None for success.
        as_json: Report errors as one JSON object on standard output too.
        debug: Let an unexpected exception through with its traceback.

    Returns:
        0, or 2 for input a user can mend, 130 after Ctrl-C, 1 for a fault of the program.
    """
    try:
        return command() or 0
    except MorphError as error:
        cause, remedy, status = error.cause, error.remedy, BAD_INPUT
    except typer.TyperException as error:
        cause, remedy, status = _usage(error)
    except KeyboardInterrupt:
        cause, remedy, status = "Stopped by Ctrl-C.", "Run the command again.", INTERRUPTED
    except BrokenPipeError:
        # whoever read our output has enough; keep the interpreter's last flush quiet
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError:
        cause = "There is not enough memory for this."
        remedy, status = "Use fewer points per cell edge, or free memory.", BAD_INPUT
    except Exception as error:
        if debug:
            raise
        cause, remedy, status = *_report(error), UNEXPECTED
    if as_json:
        print_json({"error": {"cause": cause, "remedy": remedy}})
    sys.stderr.write(f"{cause}\n{remedy}\n")
    return status


def print_json(document: object) -> None:
    """Write one JSON object to standard output; non-finite numbers become null."""
    text = json.dumps(_finite(document), indent=2)
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value


def _usage(error: typer.TyperException) -> tuple[str, str, int]:
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "morph"
    cause = error.format_message().rstrip(".")
    return f"{cause}.", f"See {command} --help.", BAD_INPUT


def _report(error: Exception) -> tuple[str, str]:
    frame = error.__traceback__
    while frame and frame.tb_next:
        frame = frame.tb_next
    place = ""
    if frame:
        code = frame.tb_frame.f_code
        place = f" in {os.path.basename(code.co_filename)}, line {frame.tb_lineno}"
    version = metadata.version("chamfer-morph")
    return (
        f"This is a fault of the program: {type(error).__name__}: {error}{place}.",
        f"Please report that line, your command, chamfer-morph {version}, Python "
        f"{platform.python_version()} and {platform.platform()}; --debug shows the traceback.",
    )
