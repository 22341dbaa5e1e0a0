"""Commands that compute a morph on this machine: run and rerun."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.exit_status import print_json
from chamfer_morph.cli.options import (
    SHAPE_HELP,
    DeviceOption,
    FitOption,
    FrameCountOption,
    JsonOption,
    MethodOption,
    PointsOption,
    PresetOption,
    QuietOption,
    ResultFileOption,
    SeedOption,
    SetOption,
    TargetArgument,
)

if TYPE_CHECKING:
    from chamfer_morph.cli.local_run import Summary

app: typer.Typer = typer.Typer()

ThreadsOption = Annotated[int, typer.Option(min=0, help="CPU threads; 0 takes every core.")]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Go on with an unfinished run.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace a result.")]


@app.command()
def run(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SHAPE_HELP)],
    target: TargetArgument,
    method: MethodOption = None,
    preset: PresetOption = "fast",
    frames: FrameCountOption = None,
    points_per_cell_edge: PointsOption = None,
    fit: FitOption = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    out: ResultFileOption = None,
    resume: ResumeOption = False,
    force: ForceOption = False,
    device: DeviceOption = "auto",
    threads: ThreadsOption = 0,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Morph SOURCE into TARGET."""
    from chamfer_morph.cli.arguments import default_output, parse_overrides
    from chamfer_morph.cli.local_run import run as run_to_end
    from morph_engine.morphing import prepare
    from morph_engine.presets import configure

    overrides = parse_overrides(
        settings,
        method=method,
        frames=frames,
        seed=seed,
        points_per_cell_edge=points_per_cell_edge,
        fit=fit,
    )
    config = configure(preset, overrides)
    summary = run_to_end(
        prepare(source, target, config),
        out or default_output(source, target),
        device=device,
        threads=threads,
        resume=resume,
        force=force,
        quiet=quiet,
        on_interrupt=partial(_report, as_json=as_json),
    )
    _report(summary, as_json=as_json)


@app.command()
def rerun(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result file.")],
    out: Annotated[
        Path | None, typer.Option(help="New result file; RESULT-rerun.vtkhdf if not given.")
    ] = None,
    resume: ResumeOption = False,
    force: ForceOption = False,
    device: DeviceOption = "auto",
    threads: ThreadsOption = 0,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Repeat a run from its result file alone, and say how far the two end apart."""
    from chamfer_morph.cli.local_run import repeated, rerun_difference
    from chamfer_morph.cli.local_run import run as run_to_end

    summary = run_to_end(
        repeated(result),
        out or result.with_name(f"{result.stem}-rerun.vtkhdf"),
        device=device,
        threads=threads,
        resume=resume,
        force=force,
        quiet=quiet,
        on_interrupt=partial(_report, as_json=as_json),
    )
    difference = rerun_difference(result, summary)
    _report(summary, as_json=as_json, difference=difference)
    if not as_json:
        typer.echo(f"largest difference from {result}: {difference:.3g} grid units")


def _report(summary: Summary, *, as_json: bool, **more: float) -> None:
    """Print what a run has come to."""
    from chamfer_morph.cli.tables import print_summary

    if as_json:
        print_json(summary.document() | more)
    elif summary.frames:
        print_summary(summary.document())
    sys.stdout.flush()
    if summary.interrupted:
        interrupt.report(
            f"Stopped by Ctrl-C after {summary.frames} frames.",
            "Continue with the same command and --resume.",
        )
