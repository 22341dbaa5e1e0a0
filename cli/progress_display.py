"""What changes while it lasts: a progress display on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import TracebackType
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress, ProgressColumn
from rich.text import Text

Self = TypeVar("Self", bound="Live")


class Live:
    """A live display on a terminal; elsewhere only what is said with `note`.

    Args:
        columns: What a line of the display is made of.
        quiet: Show nothing.
    """

    def __init__(self, *columns: ProgressColumn, quiet: bool) -> None:
        self._console = Console(file=sys.stderr, quiet=quiet, highlight=False)
        self._progress = Progress(
            *columns,
            console=self._console,
            transient=True,
            disable=quiet or not self._console.is_terminal,
        )

    def __enter__(self: Self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def note(self, text: str) -> None:
        """Say something that stays."""
        self._console.print(Text(text))

    def share(self, what: str) -> Callable[[int, int], None]:
        """A line that shows how much is done; returns what to call with that and the total."""
        task = self._progress.add_task(what, total=None)
        return lambda done, total: self._progress.update(task, completed=done, total=total)
