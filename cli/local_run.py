"""One run from the command line: progress while it lasts, Ctrl-C, and what to say at its end."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.options import ExecutionOptions
from chamfer_morph.cli.output import print_json
from chamfer_morph.cli.progress_display import RunDisplay
from chamfer_morph.cli.tables import print_summary
from morph_engine import morphing
from morph_engine.errors import ResultError
from morph_engine.peak_memory import peak_memory
from morph_engine.results.run_record import Json, RunRecord, software_versions
from morph_engine.results.spool import Spool, spool_path
from morph_engine.results.trajectory import Trajectory, write_result


@dataclass
class Summary:
    """What a run has come to: its finished frames, the metrics of the last one, all events."""

    record: RunRecord
    out: Path
    frames: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    events: list[Json] = field(default_factory=list)
    interrupted: bool = False

    def document(self) -> dict[str, Any]:
        """All of it, and what it cost this process, as one JSON object."""
        process = psutil.Process()
        return {
            **self.metrics,
            "frames": self.frames,
            "particle_count": len(self.record.source_points),
            "target_count": len(self.record.target_points),
            "method": self.record.config.method.name,
            "preset": self.record.config.preset,
            "reference": "volume",
            "interrupted": self.interrupted,
            "out": str(self.out),
            "wall_s": time.time() - process.create_time(),
            "cpu_s": time.process_time(),
            "peak_rss_mb": peak_memory() / 1e6,
            "events": self.events,
        }


def run(record: RunRecord, out: Path, execution: ExecutionOptions) -> Summary:
    """Run to the end, or to Ctrl-C; either way the finished frames are in the result file.

    Raises:
        MorphError: The result file is there already, or as `morphing.run`.
    """
    if out.exists() and not (execution.resume or execution.force):
        resumable = "continue it with --resume, " if spool_path(out).exists() else ""
        raise ResultError(
            f"{out} already exists.",
            f"Choose another file with --out, {resumable}or replace it with --force.",
        )
    summary = Summary(record, out)
    last_leg = record.leg_count - 1

    def stop() -> None:
        report(write_partial_result(record, out), as_json=execution.as_json)

    with (
        interrupt.at_interrupt(stop),
        RunDisplay(record.planned_frames, quiet=execution.quiet) as display,
    ):
        if record.placement.message:
            display.print(f"{record.placement.message} Use --fit none to keep shapes as they are.")
        if record.placement.turning:
            kept = f"Use --up {record.placement.up} to keep them as they are."
            display.print(f"{record.placement.turning} {kept}")
        frames = morphing.run(
            record,
            device=execution.device,
            threads=execution.threads,
            out=out,
            resume=execution.resume,
            overwrite=execution.force,
            on_stage=display.describe,
        )
        for frame in frames:
            summary.frames = frame.index + 1
            summary.metrics = frame.metrics
            summary.events += [event.document() for event in frame.events]
            display.show(frame)
            stopped = any(event.kind == "stopped" for event in frame.events)
            if frame.index == record.planned_frames - 1 or (stopped and frame.leg == last_leg):
                interrupt.ignore()  # what remains is to write the file
    return summary


def write_partial_result(record: RunRecord, out: Path) -> Summary:
    """Make the result file of the frames that are safe by now, while the run still lasts.

    Raises:
        ResultError: The disk refuses.
    """
    try:
        spool = Spool.open(out, record, writable=False)
    except ResultError:  # this run has not begun
        return Summary(record, out, interrupted=True)
    with spool:
        count = spool.frame_count
        if count or not out.exists():
            write_result(spool, status="partial")
        metrics = spool.metrics(count - 1) if count else {}
        return Summary(record, out, count, metrics, spool.events, interrupted=True)


def report(summary: Summary, *, as_json: bool, **more: float) -> None:
    """Print what a run has come to."""
    if as_json:
        print_json(summary.document() | more)
    elif summary.frames:
        print_summary(summary.document())
    sys.stdout.flush()
    if summary.interrupted:
        interrupt.report(
            f"Stopped by Ctrl-C after {summary.frames} frames.",
            "To continue, repeat the command with --resume.",
        )


def record_to_rerun(result: Path) -> RunRecord:
    """The record of a finished run, to be run again with the software of today.

    Raises:
        ResultError: The result cannot be read.
    """
    with Trajectory(result) as original:
        record = original.run
    versions = software_versions()
    for name, version in versions.items():
        if record.software.get(name) != version:
            before = record.software.get(name, "absent")
            sys.stderr.write(f"{name} was {before} in the original run and is {version} now.\n")
    return replace(record, software=versions)


def rerun_difference(result: Path, summary: Summary) -> float:
    """Largest distance between the particles of a result and of its rerun [dx].

    Taken at the last frame that both have.

    Raises:
        ResultError: Either cannot be read.
    """
    with Trajectory(result) as original, Trajectory(summary.out) as again:
        last = min(original.frame_count, again.frame_count) - 1
        difference = original.positions(last) - again.positions(last)
    return float(np.linalg.norm(difference, axis=1).max())
