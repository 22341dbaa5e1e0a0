"""`morph reproduce`: the paper's tables, computed here or by a service."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.exit_status import JOB_FAILED
from chamfer_morph.cli.options import JsonOption, KeyOption, QuietOption, ServiceOptions
from chamfer_morph.cli.output import print_json

if TYPE_CHECKING:
    from chamfer_morph.reproduction.meshes import MeshFolder
    from chamfer_morph.reproduction.registry import AnyExperiment
    from chamfer_morph.reproduction.report.section import Section
    from chamfer_morph.reproduction.runs.run import Run
    from chamfer_morph.reproduction.runs.store import Record, Store

app: typer.Typer = typer.Typer()


@app.command()
def reproduce(
    tables: Annotated[
        list[str] | None,
        typer.Argument(metavar="[TABLE...]", help="Names, or all; omit to list them."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, max=256, help="Runs at the same time; default: one per core."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Use the preset fast instead of published.")
    ] = False,
    results: Annotated[
        Path, typer.Option(help="Folder for runs, tables, figures and the report.")
    ] = Path("reproduced"),
    meshes: Annotated[
        Path, typer.Option(envvar="MORPH_MESHES", help="Folder of the paper's meshes.")
    ] = Path("meshes"),
    fetch: Annotated[
        bool,
        typer.Option("--fetch", help="First fetch the meshes that are missing from that folder."),
    ] = False,
    any_code: Annotated[
        bool, typer.Option("--any-code", help="Also accept finished runs of other code.")
    ] = False,
    server: Annotated[
        str | None, typer.Option(help="Have the service at this address compute the runs.")
    ] = None,
    key: KeyOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Reproduce tables and figures of the paper, each number next to the printed one.

    Runs of this code are kept and reused; repeat an interrupted command to continue it.
    """
    from chamfer_morph.cli.reproduce_display import EndsDisplay
    from chamfer_morph.reproduction.meshes import ASSETS, MeshFolder
    from chamfer_morph.reproduction.registry import runs_of, select
    from chamfer_morph.reproduction.report.writer import write
    from chamfer_morph.reproduction.runs.ends import with_ends
    from chamfer_morph.reproduction.runs.store import Store

    if not tables:
        return _print_list(as_json=as_json)
    experiments = select(tables, quick=quick)
    folder, store = MeshFolder(meshes), Store(results)
    shapes = {name for run in runs_of(experiments) for name in run.shapes}
    if fetch:
        from chamfer_morph.cli.mesh_fetch import fetch_meshes

        fetch_meshes(meshes, sorted(shapes & set(ASSETS)), quiet=quiet)
    folder.check(shapes)
    records = _compute(
        experiments,
        store,
        folder,
        jobs=jobs,
        any_code=any_code,
        server=server,
        key=key,
        quiet=quiet,
    )
    with EndsDisplay(quiet=quiet) as display:
        records = with_ends(
            _runs_by_mesh(experiments), records, store, folder, on_progress=display.show
        )
    output = write(experiments, records, store)
    failed = [record for record in records.values() if not record.is_complete]
    if as_json:
        print_json(
            {
                "report": str(output.report),
                "tables": {section.name: _document(section) for section in output.sections},
                "failed": {record.run.id: record.problem for record in failed},
            }
        )
    else:
        from chamfer_morph.cli.reproduce_display import print_section

        for section in output.sections:
            print_section(section)
        typer.echo(f"\n{output.report}")
    for record in failed:
        sys.stderr.write(f"{record.run.id} failed: {record.problem}\n")
    if failed:
        raise typer.Exit(JOB_FAILED)


def _compute(
    experiments: tuple[AnyExperiment, ...],
    store: Store,
    meshes: MeshFolder,
    *,
    jobs: int | None,
    any_code: bool,
    server: str | None,
    key: str | None,
    quiet: bool,
) -> dict[str, Record]:
    """Compute what is missing, here or by a service; the records of all runs."""
    from chamfer_morph.cli.reproduce_display import ReproductionDisplay, print_plan
    from chamfer_morph.reproduction.registry import runs_of
    from chamfer_morph.reproduction.runs.runner import default_jobs, execute, known_records

    at_once = jobs or default_jobs()
    runs = runs_of(experiments)
    known = known_records(runs, store, meshes, any_code=any_code)
    missing = [run for run in runs if run.id not in known]
    outdated = known_records(missing, store, meshes, any_code=True)
    if not quiet:
        print_plan(missing, known=len(known), outdated=len(outdated), jobs=at_once, server=server)
    kept = "the jobs on the service continue" if server else "finished frames are kept"
    lines = f"Stopped by Ctrl-C; {kept}.", "Repeat the command to continue."
    with (
        interrupt.at_interrupt(partial(interrupt.report, *lines)),
        ReproductionDisplay(jobs=at_once, quiet=quiet) as display,
    ):
        if server is None:
            return execute(
                runs, store, meshes, jobs=at_once, any_code=any_code, on_progress=display.show
            )
        from chamfer_morph.cli.remote_runs import execute_remotely

        with ServiceOptions(server, key).connect() as client:
            return execute_remotely(
                client, runs, store, meshes, any_code=any_code, on_progress=display.show
            )


def _runs_by_mesh(experiments: Iterable[AnyExperiment]) -> tuple[Run, ...]:
    """Runs whose ends are measured by points that no method has seen."""
    from chamfer_morph.reproduction.experiments.experiment import Experiment
    from chamfer_morph.reproduction.registry import runs_of

    return runs_of(each for each in experiments if isinstance(each, Experiment) and each.by_mesh)


def _print_list(*, as_json: bool) -> None:
    """Print what there is to reproduce."""
    from chamfer_morph.cli.tables import format_duration, print_table
    from chamfer_morph.reproduction.registry import EXPERIMENTS, cpu_seconds_of, runs_of

    rows = [
        (name, each.title, each.origin, len(runs_of([each])), cpu_seconds_of([each]))
        for name, each in EXPERIMENTS.items()
    ]
    if as_json:
        names = ("name", "title", "origin", "runs", "cpu_seconds")
        print_json({"tables": [dict(zip(names, row, strict=True)) for row in rows]})
    else:
        print_table(
            ("table", "what it is", "in the paper", "runs", "CPU time"),
            ((*row[:3], str(row[3]), format_duration(row[4])) for row in rows),
        )
        typer.echo("\nTables share runs, so all takes less than their sum.")


def _document(section: Section) -> dict[str, Any]:
    """A section as JSON: every number by row and metric, and what they show."""
    import csv
    import io

    numbers = list(csv.DictReader(io.StringIO(section.csv)))
    return {"title": section.title, "verdict": list(section.findings), "numbers": numbers}
