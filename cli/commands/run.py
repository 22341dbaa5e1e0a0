"""Commands that compute a morph on this machine: run and rerun."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Annotated

import typer

from chamfer_morph.cli.arguments import default_output
from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import (
    SHAPE_HELP,
    ConfigOptions,
    ExecutionOptions,
    MethodCommand,
    MethodOption,
    ResultFileOption,
    SeedOption,
    TargetArguments,
)

app: typer.Typer = typer.Typer()

GARBAGE_THRESHOLD = 100_000
"""New objects after which Python looks for garbage. Most of what imports and kernels make stays, so
that with the usual threshold, 700 in Python 3.11, looking takes a twentieth of the time to the
first frame."""


@app.command(cls=MethodCommand)
@expand_groups
def run(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SHAPE_HELP)],
    targets: TargetArguments,
    *,
    method: MethodOption = None,
    config: ConfigOptions,
    seed: SeedOption = None,
    out: ResultFileOption = None,
    execution: ExecutionOptions,
) -> None:
    """Morph SOURCE into TARGET, or through several."""
    _set_up()
    from chamfer_morph.cli import local_run
    from morph_engine.morphing import prepare
    from morph_engine.presets import configure

    overrides = config.overrides(method=method, frames=config.frames, seed=seed)
    record = prepare(source, targets, configure(config.preset, overrides))
    summary = local_run.run(record, out or default_output(source, *targets), execution)
    local_run.report(summary, as_json=execution.as_json)


@app.command()
@expand_groups
def rerun(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result file.")],
    *,
    out: Annotated[
        Path | None, typer.Option(help="New result file; default: RESULT-rerun.vtkhdf.")
    ] = None,
    execution: ExecutionOptions,
) -> None:
    """Repeat a run from its result file alone, and print how far apart the two end."""
    _set_up()
    from chamfer_morph.cli import local_run
    from morph_engine.results.trajectory import check_replaces_no_result

    out = out or result.with_name(f"{result.stem}-rerun.vtkhdf")
    check_replaces_no_result(result, out)
    summary = local_run.run(local_run.record_to_rerun(result), out, execution)
    difference = local_run.rerun_difference(result, summary)
    local_run.report(summary, as_json=execution.as_json, difference=difference)
    if not execution.as_json:
        typer.echo(f"largest difference from {result}: {difference:.3g} grid units")


def _set_up() -> None:
    """Make this process start fast, now and with the same shapes again."""
    gc.set_threshold(GARBAGE_THRESHOLD)
    from morph_engine import kept_results

    kept_results.keep_in(kept_results.user_folder())
