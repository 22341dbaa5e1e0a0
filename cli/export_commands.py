"""Commands that turn a result into what other programs open: export and render."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from chamfer_morph.cli.exit_status import print_json
from chamfer_morph.cli.interrupt import removing
from chamfer_morph.cli.options import (
    ForceOption,
    FramesOption,
    JsonOption,
    KeyOption,
    QuietOption,
    ServerOption,
    connect,
)
from morph_engine.errors import ConfigError

if TYPE_CHECKING:
    from morph_engine import export as exports

PANEL = "Results"

app: typer.Typer = typer.Typer()

ResultArgument = Annotated[
    str, typer.Argument(metavar="RESULT", help="A result file, or the id of a job of the service.")
]
SurfaceOption = Annotated[
    bool, typer.Option("--surface", help="A surface around the particles in their place.")
]


@app.command(rich_help_panel=PANEL)
def export(
    result: ResultArgument,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="The file; a .zip or a folder for many frames of a kind."),
    ],
    format: Annotated[
        str | None,
        typer.Option(
            help="ply, obj, glb, stl, usd, npz, csv, mp4 or gif; by the file's ending if not given."
        ),
    ] = None,
    frames: FramesOption = None,
    surface: SurfaceOption = False,
    units: Annotated[
        Literal["user", "grid"], typer.Option(help="Coordinates: of your files, or grid units.")
    ] = "user",
    fields: Annotated[
        str, typer.Option(metavar="A,B", help="Fields to carry along, such as speed,det_f.")
    ] = "",
    force: ForceOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write frames of a result for other programs; docs/exports.md has the formats."""
    from chamfer_morph.cli.arguments import check_output, parse_frames, parse_list
    from morph_engine import export as exports

    name = format or _format_by_suffix(out, exports.FORMATS)
    chosen = parse_list(fields)
    exports.check(name, surface=surface, fields=chosen)
    wanted = parse_frames(frames)
    check_output(out, force=force, folder=True)
    with (
        _local_file(result, server, key) as path,
        _removing_unfinished(out),
        _progress(quiet=quiet or as_json) as watch,
    ):
        exports.export(
            path,
            out,
            name,
            frames=wanted,
            surface=surface,
            units=units,
            fields=chosen,
            watch=watch,
        )
    _report(out, as_json=as_json, format=name)


@app.command(rich_help_panel=PANEL)
def render(
    result: ResultArgument,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The video; .mp4 (pip install .\\[video]) or .gif.")
    ],
    color: Annotated[
        str | None,
        typer.Option(metavar="FIELD", help="Colour by a field, such as speed or target_distance."),
    ] = None,
    surface: SurfaceOption = False,
    turntable: Annotated[
        bool, typer.Option("--turntable", help="Turn once around the shape.")
    ] = False,
    frames: FramesOption = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Pixels.")] = "960x720",
    fps: Annotated[float, typer.Option(min=1, max=60, help="Frames per second.")] = 12.0,
    up: Annotated[Literal["y", "z"], typer.Option(help="The upward axis.")] = "y",
    force: ForceOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Make a video of a result."""
    from chamfer_morph.cli.arguments import check_output, parse_frames, parse_size
    from morph_engine.rendering.pictures import video

    pixels, wanted = parse_size(size), parse_frames(frames)
    check_output(out, force=force, folder=True)
    with (
        _local_file(result, server, key) as path,
        _removing_unfinished(out),
        _progress(quiet=quiet or as_json) as watch,
    ):
        video(
            path,
            out,
            field=color,
            turntable=turntable,
            surface=surface,
            size=pixels,
            fps=fps,
            frames=wanted,
            up=up,
            watch=watch,
        )
    _report(out, as_json=as_json)


def _format_by_suffix(out: Path, formats: dict[str, exports.Format]) -> str:
    for name, known in formats.items():
        if out.suffix.lower() == known.suffix:
            return name
    raise ConfigError(
        f"{out.name} says no format.", f"Name one with --format: {', '.join(formats)}."
    )


@contextmanager
def _local_file(result: str, server: str | None, key: str | None) -> Iterator[Path]:
    """The result file, fetched from the service where a job is named."""
    from chamfer_morph.schemas.ids import is_id

    path = Path(result)
    if path.exists() or not is_id(result):
        yield path
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        removing(Path(folder).parent, Path(folder).name),
        connect(server, key) as client,
    ):
        fetched = Path(folder) / f"{result}.vtkhdf"
        client.download(result, fetched)
        yield fetched


def _removing_unfinished(out: Path) -> AbstractContextManager[None]:
    """Within, Ctrl-C leaves nothing of what is being written."""
    return removing(out.absolute().parent, f"{escape(out.name)}.tmp*")


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    from rich.progress import Progress

    from chamfer_morph.cli.progress_display import ProgressDisplay

    with ProgressDisplay(*Progress.get_default_columns(), quiet=quiet) as display:
        yield display.add_bar("frames")


def _report(out: Path, *, as_json: bool, **more: str) -> None:
    from chamfer_morph.cli.tables import size

    files = [out] if out.is_file() else sorted(out.iterdir())
    byte_count = sum(file.stat().st_size for file in files)
    if as_json:
        print_json({"out": str(out), "size_bytes": byte_count, **more})
    else:
        typer.echo(f"{out} ({size(byte_count)})")
    sys.stdout.flush()
