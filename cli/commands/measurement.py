"""Commands that measure meshes and particles: inspect and metrics."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

import typer

from chamfer_morph.cli.exit_status import BAD_INPUT
from chamfer_morph.cli.options import FIT_HELP, SHAPE_HELP, Fit, JsonOption
from chamfer_morph.cli.output import error_document, print_json, print_result
from chamfer_morph.cli.tables import print_metrics, print_report
from morph_engine.errors import ConfigError, MorphError

app: typer.Typer = typer.Typer()

OF_ONE_FRAME = ("b", "points_per_cell_edge", "reference", "frame", "tau")
"""Parameters of `metrics` that do not go with --path."""


@app.command()
def inspect(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=SHAPE_HELP)],
    fit: Annotated[Fit, typer.Option(help=FIT_HELP)] = "auto",
    as_json: JsonOption = False,
) -> None:
    """Describe a mesh: closed?, volume, particles, expected time and memory; 2 if unusable."""
    from morph_engine.geometry.shapes import resolve_shape
    from morph_engine.ingest import check_mesh, fitted, inspect_mesh

    shape = resolve_shape(mesh)
    report = inspect_mesh(shape, fit=fit)
    try:
        check_mesh(fitted(shape, fit)[0], own=shape)
    except MorphError as error:
        if as_json:
            print_json(report.model_dump(mode="json") | error_document(error))
            raise typer.Exit(BAD_INPUT) from error
        print_report(report)
        raise
    print_result(report, lambda: print_report(report), as_json=as_json)


@app.command()
def metrics(
    context: typer.Context,
    a: Annotated[
        str, typer.Argument(metavar="A", help="Particles: a mesh, point cloud, result or shape.")
    ],
    b: Annotated[
        str | None,
        typer.Argument(metavar="[B]", help="Target, of the same kinds; a result has its own."),
    ] = None,
    points_per_cell_edge: Annotated[
        int | None, typer.Option(min=1, max=8, help="Lattice points per grid cell edge.")
    ] = None,
    reference: Annotated[
        Literal["volume", "surface"], typer.Option(help="Fill meshes, or sample their surface.")
    ] = "volume",
    frame: Annotated[int, typer.Option(help="Frame of a result; negative from the end.")] = -1,
    tau: Annotated[float, typer.Option(min=0, help="Threshold of F1, in grid units.")] = 0.2,
    path: Annotated[
        bool, typer.Option("--path", help="Measure the path of a result and its end instead.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure how well A fills B: Chamfer, Hausdorff, F1, overlap, coverage, fill."""
    from morph_engine.comparison import compare

    if path:
        if any(_is_given(context, name) for name in OF_ONE_FRAME):
            raise ConfigError(
                "--path measures all frames of one result against its own target.",
                "Leave out --path, or everything but the result.",
            )
        _print_path(a, as_json=as_json)
        return

    measurement = compare(
        a,
        b,
        spacing=1 / points_per_cell_edge if points_per_cell_edge else None,
        reference=reference,
        frame=frame,
        tau=tau,
        workers=-1,
    )
    print_result(measurement.document(), lambda: print_metrics(measurement.values), as_json=as_json)


def _is_given(context: typer.Context, name: str) -> bool:
    """Whether a parameter has been typed, and is not the default."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _print_path(result: str, *, as_json: bool) -> None:
    """Measures of the path of a result; of each leg, where there are several."""
    from morph_engine.comparison import measure_path
    from morph_engine.results.trajectory import Trajectory

    with Trajectory(result) as run:
        shapes = run.run.names
        legs = [measure_path(run, leg) for leg in range(run.leg_of(-1) + 1)]
    if len(shapes) == 2:
        print_result(legs[0], lambda: print_metrics(legs[0]), as_json=as_json)
        return

    def show() -> None:
        for (source, target), values in zip(pairwise(shapes), legs, strict=False):
            typer.echo(f"{source} to {target}")
            print_metrics(values)

    print_result({"shapes": shapes, "legs": legs}, show, as_json=as_json)
