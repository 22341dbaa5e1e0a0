"""The `morph` command line: options in, engine called, a table or one JSON object out.

Heavy modules are imported where they are used, so that `morph --help` answers at once.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from chamfer_morph.cli import (
    export_commands,
    interrupt,
    job_commands,
    process_commands,
    reproduce_commands,
    service_commands,
)
from chamfer_morph.cli.exit_status import BAD_INPUT, error_document, exit_status, print_json
from morph_engine.errors import MorphError

if TYPE_CHECKING:
    from chamfer_morph.cli.local_run import Summary

app = typer.Typer(
    name="morph",
    help="Morph one 3D shape into another by differentiable physics.",
    epilog="Exit status: 0 success, 1 a job that failed or a fault of the program (--debug shows "
    "the traceback), 2 bad input, 3 no answer from the service, 130 Ctrl-C.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for _commands in (
    export_commands,
    reproduce_commands,
    job_commands,
    process_commands,
    service_commands,
):
    app.add_typer(_commands.app)

SHAPE_HELP = "A mesh file (OBJ, PLY, STL, OFF, GLB) or a built-in shape (see morph shapes)."

FIT_HELP = "Scale to the usual volume, to touch the domain, or keep the file's coordinates."

Fit = Literal["volume", "extent", "none"]
DeviceOption = Annotated[
    Literal["auto", "cpu", "cuda", "vulkan", "metal"], typer.Option(help="Where to compute.")
]
ThreadsOption = Annotated[int, typer.Option(min=0, help="CPU threads; 0 takes every core.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Show no progress.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def main() -> None:
    """Run the command that the arguments of the process name, and exit with its status."""
    arguments = sys.argv[1:]
    debug = "--debug" in arguments
    if debug:
        arguments.remove("--debug")
    sys.exit(
        exit_status(
            lambda: app(arguments, prog_name="morph", standalone_mode=False),
            as_json="--json" in arguments,
            debug=debug,
        )
    )


@app.callback()
def morph(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Morph one 3D shape into another by differentiable physics."""
    if version:
        from importlib.metadata import version as version_of

        typer.echo(f"chamfer-morph {version_of('chamfer-morph')}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def run(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SHAPE_HELP)],
    target: Annotated[str, typer.Argument(metavar="TARGET", help="What it is to become.")],
    method: Annotated[str | None, typer.Option(help="See morph methods.")] = None,
    preset: Annotated[str, typer.Option(help="See morph presets.")] = "fast",
    frames: Annotated[int | None, typer.Option(help="Frames to compute.")] = None,
    points_per_cell_edge: Annotated[
        int | None, typer.Option(help="Particles per grid cell edge: 2 quick, 3 usual, 4 fine.")
    ] = None,
    fit: Annotated[Fit | None, typer.Option(help=FIT_HELP)] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random choice.")] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PATH=VALUE", help="Any setting; see morph presets fast."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Result file; SOURCE-to-TARGET.vtkhdf if not given.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with an unfinished run.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a result.")] = False,
    device: DeviceOption = "auto",
    threads: ThreadsOption = 0,
    quiet: QuietOption = False,
    as_json: AsJson = False,
) -> None:
    """Morph SOURCE into TARGET."""
    from chamfer_morph.cli.arguments import default_out, parse_overrides
    from chamfer_morph.cli.local_run import run as run_to_end
    from morph_engine.morphing import prepare
    from morph_engine.presets import configure

    options = {
        "method": method,
        "frames": frames,
        "seed": seed,
        "sampling.points_per_cell_edge": points_per_cell_edge,
        "sampling.fit": fit,
    }
    chosen = {path: value for path, value in options.items() if value is not None}
    config = configure(preset, chosen | parse_overrides(settings or []))
    summary = run_to_end(
        prepare(source, target, config),
        out or default_out(source, target),
        device=device,
        threads=threads,
        resume=resume,
        force=force,
        quiet=quiet,
        on_interrupt=partial(_finish, as_json=as_json),
    )
    _finish(summary, as_json=as_json)


@app.command()
def rerun(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result file.")],
    out: Annotated[
        Path | None, typer.Option(help="New result file; RESULT-rerun.vtkhdf if not given.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with an unfinished run.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a result.")] = False,
    device: DeviceOption = "auto",
    threads: ThreadsOption = 0,
    quiet: QuietOption = False,
    as_json: AsJson = False,
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
        on_interrupt=partial(_finish, as_json=as_json),
    )
    difference = rerun_difference(result, summary)
    _finish(summary, as_json=as_json, difference=difference)
    if not as_json:
        typer.echo(f"largest difference from {result}: {difference:.3g} grid units")


def _finish(summary: Summary, *, as_json: bool, **more: float) -> None:
    """Say what a run has come to."""
    from chamfer_morph.cli.display import print_summary

    if as_json:
        print_json(summary.document() | more)
    elif summary.frames:
        print_summary(summary.document())
    sys.stdout.flush()
    if summary.interrupted:
        interrupt.say(
            f"Stopped by Ctrl-C after {summary.frames} frames.",
            "Continue with the same command and --resume.",
        )


@app.command()
def methods(as_json: AsJson = False) -> None:
    """List the methods."""
    from chamfer_morph.cli.display import print_table
    from morph_engine import methods as known

    rows = {name: known.find(name).summary() for name in known.names()}
    if as_json:
        print_json({"methods": rows})
    else:
        print_table(("method", "what it does"), rows.items())


@app.command()
def shapes(as_json: AsJson = False) -> None:
    """List the built-in shapes; text:HELLO makes extruded letters of any string."""
    from morph_engine.geometry.shapes import names

    if as_json:
        print_json({"shapes": list(names())})
    else:
        typer.echo("\n".join((*names(), "text:ANY STRING")))


@app.command()
def presets(
    name: Annotated[str | None, typer.Argument(help="Show the settings of this one.")] = None,
    describe: Annotated[
        str | None, typer.Option(metavar="SECTION", help="Only settings of this section.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the presets, or every setting of one with its meaning and range."""
    from chamfer_morph.cli.display import print_settings, print_table
    from morph_engine import presets as known

    if as_json:
        chosen = [name] if name else known.names()
        print_json({each: known.configure(each).model_dump(mode="json") for each in chosen})
    elif name or describe:
        print_settings(known.configure(name or known.DEFAULT), section=describe)
    else:
        print_table(
            ("preset", "what it is"), ((each, known.describe(each)) for each in known.names())
        )


@app.command()
def inspect(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=SHAPE_HELP)],
    fit: Annotated[Fit, typer.Option(help=FIT_HELP)] = "none",
    as_json: AsJson = False,
) -> None:
    """Describe a mesh: closed?, volume, particles, expected time and memory; 2 if unusable."""
    from chamfer_morph.cli.display import print_report
    from morph_engine.geometry.ingest import check_mesh, inspect_mesh
    from morph_engine.geometry.sampling import fit_to_domain
    from morph_engine.geometry.shapes import resolve_shape

    fitted, _ = fit_to_domain(resolve_shape(mesh), mode=fit)
    report = inspect_mesh(fitted)
    try:
        check_mesh(fitted)
    except MorphError as error:
        if as_json:
            print_json(report.model_dump(mode="json") | error_document(error))
            raise typer.Exit(BAD_INPUT) from error
        print_report(report)
        raise
    if as_json:
        print_json(report.model_dump(mode="json"))
    else:
        print_report(report)


@app.command()
def metrics(
    a: Annotated[
        str, typer.Argument(metavar="A", help="Particles: a mesh, point cloud, result or shape.")
    ],
    b: Annotated[
        str | None,
        typer.Argument(metavar="[B]", help="Target, the same kinds; a result has its own."),
    ] = None,
    points_per_cell_edge: Annotated[
        int | None, typer.Option(min=1, max=8, help="Lattice points per grid cell edge.")
    ] = None,
    reference: Annotated[
        Literal["volume", "surface"], typer.Option(help="Fill meshes, or sample their surface.")
    ] = "volume",
    frame: Annotated[int, typer.Option(help="Frame of a result; negative from the end.")] = -1,
    tau: Annotated[float, typer.Option(min=0, help="Threshold of F1, in grid units.")] = 0.2,
    as_json: AsJson = False,
) -> None:
    """Measure how well A fills B: Chamfer, Hausdorff, F1, overlap, coverage, fill."""
    from chamfer_morph.cli.display import print_metrics
    from morph_engine.comparison import compare

    measurement = compare(
        a,
        b,
        spacing=1 / points_per_cell_edge if points_per_cell_edge else None,
        reference=reference,
        frame=frame,
        tau=tau,
        workers=-1,
    )
    if as_json:
        print_json(measurement.document())
    else:
        print_metrics(measurement.values)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def bench(context: typer.Context) -> None:
    """Measure speed against peers on this machine; further arguments go to the benchmarks."""
    import subprocess

    root = Path(__file__).resolve().parents[1]
    if not (root / "benchmarks").is_dir():
        raise MorphError(
            "The benchmarks are part of the source, not of the installed package.",
            "Clone the project and run make bench there.",
        )
    command = [sys.executable, "-m", "benchmarks", *context.args]
    raise typer.Exit(subprocess.run(command, cwd=root, check=False).returncode)
