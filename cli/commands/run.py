"""Commands that compute a morph on this machine: run and rerun."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.arguments import default_output
from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import (
    SHAPE_HELP,
    ConfigOptions,
    DeviceOption,
    JsonOption,
    MethodCommand,
    MethodOption,
    QuietOption,
    ResultFileOption,
    SeedOption,
    TargetArgument,
)
from chamfer_morph.cli.output import print_json
from chamfer_morph.cli.tables import print_summary

if TYPE_CHECKING:
    from chamfer_morph.cli.local_run import Summary
    from morph_engine.results.run_record import RunRecord

app: typer.Typer = typer.Typer()


@dataclass(frozen=True)
class ExecutionOptions:
    """How a run is computed on this machine."""

    resume: Annotated[bool, typer.Option("--resume", help="Go on with an unfinished run.")] = False
    force: Annotated[bool, typer.Option("--force", help="Replace a result.")] = False
    device: DeviceOption = "auto"
    threads: Annotated[int, typer.Option(min=0, help="CPU threads; 0 takes every core.")] = 0
    quiet: QuietOption = False
    as_json: JsonOption = False

    def compute(self, record: RunRecord, out: Path) -> Summary:
        """Run to the end, or to Ctrl-C."""
        from chamfer_morph.cli.local_run import run

        return run(
            record,
            out,
            device=self.device,
            threads=self.threads,
            resume=self.resume,
            force=self.force,
            quiet=self.quiet,
            on_interrupt=partial(_report, as_json=self.as_json),
        )


@app.command(cls=MethodCommand)
@expand_groups
def run(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SHAPE_HELP)],
    target: TargetArgument,
    *,
    method: MethodOption = None,
    config: ConfigOptions,
    seed: SeedOption = None,
    out: ResultFileOption = None,
    execution: ExecutionOptions,
) -> None:
    """Morph SOURCE into TARGET."""
    from morph_engine.morphing import prepare
    from morph_engine.presets import configure

    overrides = config.overrides(method=method, frames=config.frames, seed=seed)
    record = prepare(source, target, configure(config.preset, overrides))
    summary = execution.compute(record, out or default_output(source, target))
    _report(summary, as_json=execution.as_json)


@app.command()
@expand_groups
def rerun(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result file.")],
    *,
    out: Annotated[
        Path | None, typer.Option(help="New result file; RESULT-rerun.vtkhdf if not given.")
    ] = None,
    execution: ExecutionOptions,
) -> None:
    """Repeat a run from its result file alone, and say how far the two end apart."""
    from chamfer_morph.cli.local_run import record_to_rerun, rerun_difference

    out = out or result.with_name(f"{result.stem}-rerun.vtkhdf")
    summary = execution.compute(record_to_rerun(result), out)
    difference = rerun_difference(result, summary)
    _report(summary, as_json=execution.as_json, difference=difference)
    if not execution.as_json:
        typer.echo(f"largest difference from {result}: {difference:.3g} grid units")


def _report(summary: Summary, *, as_json: bool, **more: float) -> None:
    """Print what a run has come to."""
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
