"""Ctrl-C.

An exception raised at a random instruction can vanish in the libraries at work there, or break
them: a third of all KeyboardInterrupts during the start of a run did. So Ctrl-C never raises here.
It ends the process at once, after what the command at work wants done first; that can rely on the
run directory, which is whole at any instant.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType

INTERRUPTED = 130

Action = Callable[[], None]

_SHOW_CURSOR = "\x1b[?25h"


def report(*lines: str) -> None:
    """Write lines to standard error, whatever the interrupted code was writing there."""
    cursor = _SHOW_CURSOR + "\r\n" if sys.stderr.isatty() else ""
    os.write(2, (cursor + "".join(f"{line}\n" for line in lines)).encode())


_action: Action = partial(report, "Stopped by Ctrl-C.", "Run the command again.")


def install() -> None:
    """From now on Ctrl-C ends the process with exit status 130."""
    signal.signal(signal.SIGINT, _stop)


@contextmanager
def at_interrupt(action: Action) -> Iterator[None]:
    """Within, Ctrl-C does this before it ends the process."""
    global _action
    before, _action = _action, action
    try:
        yield
    finally:
        _action = before
        install()


@contextmanager
def removing(folder: Path, pattern: str) -> Iterator[None]:
    """Within, Ctrl-C removes what a pattern finds in a folder before it does what it would do."""
    action = _action

    def remove() -> None:
        for path in folder.glob(pattern):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        action()

    with at_interrupt(remove):
        yield


def ignore() -> None:
    """Let Ctrl-C wait, while a file is written that is nearly done."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _stop(number: int, frame: FrameType | None) -> None:
    ignore()
    try:
        _action()
    except Exception as error:
        report("Stopped by Ctrl-C.", str(error))
    finally:
        os._exit(INTERRUPTED)
