"""CSV: the metrics of each frame as a table."""

from __future__ import annotations

import csv
from pathlib import Path

from morph_engine.export.format import Format
from morph_engine.results.selection import Selection


def write(selection: Selection, path: Path) -> None:
    """Write the table, a frame a row; arguments as for `Format.write`. What is absent is empty."""
    metrics = selection.trajectory.metrics
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, ["frame", *metrics])
        table.writeheader()
        for frame in selection.frames:
            table.writerow({"frame": frame, **selection.trajectory.metrics_at(frame)})
    selection.watch(len(selection.frames), len(selection.frames))


FORMAT = Format(
    name="csv",
    suffix=".csv",
    media_type="text/csv",
    kind="table",
    description="Metrics by frame; spreadsheets, pandas",
    write=write,
)
