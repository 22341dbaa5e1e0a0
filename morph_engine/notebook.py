"""What a morph shows in a Jupyter notebook: how far it is, and then a viewer."""

from __future__ import annotations

import html
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morph_engine.results.trajectory import Trajectory

if TYPE_CHECKING:
    from morph_engine.morphing import Frame, Stage
    from morph_engine.results.run_record import RunRecord

SECONDS_BETWEEN = 0.3
"""Progress is shown no more often than this."""

Compute = Callable[[Path, Callable[["Stage"], None]], Iterator["Frame"]]
"""Yields the frames of a morph, whose result file is named; tells its stages."""


def show(record: RunRecord, compute: Compute, out: str | Path | None) -> None:
    """Compute a morph in the cell that displays it, and end with a viewer.

    Args:
        record: What is computed.
        compute: Computes it.
        out: The result file; without one the result is gone afterwards.
    """
    cell = Cell()
    total, names = record.planned_frames, " to ".join(record.names)
    done, shown = 0, 0.0

    def on_stage(stage: Stage) -> None:
        cell.progress(f"{names}: {stage}", done / total)

    with _result_file(out) as path:
        try:
            for frame in compute(path, on_stage):
                done += 1
                if time.monotonic() - shown >= SECONDS_BETWEEN:
                    shown = time.monotonic()
                    distance = f"{frame.metrics['two_sided']:.2f} dx from the target"
                    cell.progress(f"{names}: frame {done} of {total}, {distance}", done / total)
        except BaseException:
            kept = f"; `resume=True` continues {path.name}" if out and done else ""
            cell.show(f"{names}: stopped after {done} of {total} frames{kept}")
            raise
        with Trajectory(path) as trajectory:
            words = f"{names}: {done} frames of {record.particle_count:,} particles"
            where = f", in {path.name}" if out else ""
            cell.show(words + where, trajectory._repr_html_())


class Cell:
    """The output of the cell that is being displayed; what is shown last replaces the rest.

    At IPython's prompt nothing can be replaced, and progress is left out.
    """

    def __init__(self) -> None:
        from IPython.core.getipython import get_ipython
        from IPython.display import DisplayHandle

        handle: Any = DisplayHandle  # which is not typed
        self._handle = handle()
        self._replaces = hasattr(get_ipython(), "kernel")
        self._begun = False

    def progress(self, words: str, share: float) -> None:
        """Show a bar and what it stands for."""
        if self._replaces:
            bar = f'<progress value="{share:.3f}" style="width: 20em"></progress>'
            self.show(words, f"{bar} {html.escape(words)}")

    def show(self, words: str, page: str | None = None) -> None:
        """Show HTML, or the words where there is none or it cannot be shown."""
        content = {"text/plain": words} | ({"text/html": page} if page else {})
        show = self._handle.update if self._begun and self._replaces else self._handle.display
        self._begun = True
        show(content, raw=True)


@contextmanager
def _result_file(out: str | Path | None) -> Iterator[Path]:
    """The file that is asked for, or one that is removed at the end."""
    if out is not None:
        yield Path(out)
        return
    with tempfile.TemporaryDirectory(prefix="morph-") as folder:
        yield Path(folder) / "morph.vtkhdf"
