"""Progress on standard error: live on a terminal, a line each elsewhere."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
from rich.text import Text

from chamfer_morph.cli.tables import format_duration, format_losses

if TYPE_CHECKING:
    from morph_engine.morphing import Frame

Self = TypeVar("Self", bound="ProgressDisplay")


class ProgressDisplay:
    """A live display on a terminal, of lines of these columns; elsewhere the lines of `print`."""

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

    def __exit__(self, *details: object) -> None:
        self._progress.stop()

    def print(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(Text(text))

    def add_bar(self, label: str) -> Callable[[int, int], None]:
        """A line that shows how much is done; returns what to call with that and the total."""
        task = self._progress.add_task(label, total=None)
        return lambda done, total: self._progress.update(task, completed=done, total=total)

    def add_text(self) -> Callable[[str], None]:
        """A line of text; returns what to call with what it is to say."""
        task = self._progress.add_task("", total=None)
        return lambda text: self._progress.update(task, description=text)


class RunDisplay(ProgressDisplay):
    """Progress of one run: frame, loss, Chamfer distance, time left, and events as they happen.

    On a terminal it is one live line; elsewhere each frame is a line of its own.
    """

    def __init__(self, frame_count: int, *, quiet: bool = False) -> None:
        super().__init__(
            TextColumn("{task.completed}/{task.total}"),
            BarColumn(),
            TextColumn("{task.description}"),
            quiet=quiet,
        )
        self._frame_count = frame_count
        self._recent: deque[float] = deque(maxlen=5)
        self._task = self._progress.add_task("preparing", total=frame_count)

    def show(self, frame: Frame) -> None:
        """Show a finished frame."""
        for event in frame.events:
            if event.kind != "placement":  # told before the first frame
                self.print(f"in frame {event.frame}: {event.message}")
        self.advance(frame.index, frame.metrics, frame.seconds)

    def describe(self, text: str, *, done: int | None = None) -> None:
        """Show on a terminal what goes on and, where it has changed, how much is finished."""
        self._progress.update(self._task, description=text, completed=done)

    def advance(self, index: int, metrics: Mapping[str, float], seconds: float) -> None:
        """Show that a frame is finished; it took 0 s if it was there before a resumed run."""
        done = index + 1
        text = format_losses(metrics)
        if seconds:
            self._recent.append(seconds)
            left = sum(self._recent) / len(self._recent) * (self._frame_count - done)
            text += f"  left {format_duration(left)}"
        if self._progress.disable:
            self._console.print(f"frame {index}  {done}/{self._frame_count}  {text}")
        else:
            self._progress.update(self._task, completed=done, description=text)
