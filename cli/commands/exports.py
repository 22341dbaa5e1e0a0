"""Commands that turn a result into what other programs open: export and render."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer
from rich.progress import Progress

from chamfer_morph.cli.arguments import (
    check_output,
    parse_camera_keys,
    parse_frames,
    parse_list,
    parse_size,
)
from chamfer_morph.cli.interrupt import removing
from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import ForceOption, QuietOption, ServiceOptions
from chamfer_morph.cli.progress_display import ProgressDisplay
from chamfer_morph.cli.tables import format_size
from morph_engine.errors import ConfigError

if TYPE_CHECKING:
    from morph_engine import export as exports
    from morph_engine.results.timeline import Timing

PANEL = "Results"

VIDEO_FRAMES_PER_SECOND = 12.0

app: typer.Typer = typer.Typer()

ResultArgument = Annotated[
    str, typer.Argument(metavar="RESULT", help="A result file, or the id of a job on the service.")
]


@dataclass(frozen=True)
class SelectionOptions:
    """Which frames of a result are written, and how."""

    frames: Annotated[
        str | None, typer.Option(help="Frames such as 0,5,10-20; -1 is the last. Default: all.")
    ] = None
    surface: Annotated[
        bool,
        typer.Option("--surface", help="A surface around the particles, instead of the particles."),
    ] = False
    snap: Annotated[
        bool,
        typer.Option(
            "--snap", help="With --surface: snap the first and last frames onto your own meshes."
        ),
    ] = False
    force: ForceOption = False
    quiet: QuietOption = False


@dataclass(frozen=True)
class PlaybackOptions:
    """How long a result is played, and how; apart from how many frames it has."""

    seconds: Annotated[
        float | None,
        typer.Option(help="Duration including the pauses; default: frames divided by --fps."),
    ] = None
    hold: Annotated[float | None, typer.Option(metavar="SECONDS", help="Pause at each shape.")] = (
        None
    )
    easing: Annotated[
        Literal["linear", "in-out", "overshoot"] | None,
        typer.Option(help="Even pace; slow at each shape (default); or overshoot it and return."),
    ] = None
    repeat: Annotated[
        Literal["none", "loop", "ping-pong"] | None,
        typer.Option(
            help="loop: end as it begins, for runs that return to their first shape; "
            "ping-pong: play forward, then backward."
        ),
    ] = None

    def timing(self, fps: float | None) -> Timing | None:
        """What is asked for; None where nothing of it is."""
        from morph_engine.results.timeline import Timing

        return Timing.of(fps=fps, **vars(self))


@app.command(rich_help_panel=PANEL)
@expand_groups
def export(
    result: ResultArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            help="Output file; for several frames with one file each, a .zip or a folder.",
        ),
    ],
    *,
    format: Annotated[
        str | None,
        typer.Option(
            help="ply, obj, glb, stl, usd, pc2, npz, splat, csv, html, mp4, webm, mov, gif, png; "
            "default: by the file extension."
        ),
    ] = None,
    tracked: Annotated[
        bool,
        typer.Option(
            "--tracked", help="One mesh that moves through all frames: .glb, .usdc, .html, or pc2."
        ),
    ] = False,
    texture: Annotated[
        int | None,
        typer.Option(
            help="With --tracked and .glb: store colours as a texture of this width in pixels."
        ),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            min=1,
            max=120,
            help="Frames per second; default: 24, 12 for videos, 30 with a playing time.",
        ),
    ] = None,
    units: Annotated[
        Literal["user", "source", "target", "grid"],
        typer.Option(help="Coordinates of your files, of one of them, or in grid units."),
    ] = "user",
    fields: Annotated[
        str, typer.Option(metavar="A,B", help="Fields to include, such as speed,det_f.")
    ] = "",
    playback: PlaybackOptions,
    selection: SelectionOptions,
    service: ServiceOptions,
) -> None:
    """Write frames of a result for other programs; docs/exports.md lists the formats."""
    from morph_engine import export as exports

    name = format or _format_by_suffix(out, exports.FORMATS)
    content: exports.Content = {
        "frames": parse_frames(selection.frames),
        "surface": selection.surface,
        "snap": selection.snap,
        "tracked": tracked,
        "texture": texture,
        "fps": fps,
        "timing": playback.timing(fps),
        "picture": None,
        "fields": parse_list(fields),
    }
    exports.check(name, **content)
    with _written_file(result, out, selection, service, format=name) as writing:
        exports.export(
            writing.result,
            out,
            name,
            **content,
            units=units,
            watch=writing.watch,
            tell=writing.tell,
        )


@app.command(rich_help_panel=PANEL)
@expand_groups
def view(
    result: ResultArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Save the page to this file; default: a temporary file."),
    ] = None,
    *,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
    frames: Annotated[
        str | None, typer.Option(help="Frames such as 0,5,10-20; -1 is the last. Default: all.")
    ] = None,
    surface: Annotated[
        bool | None,
        typer.Option(
            "--surface/--no-surface",
            help="Include the surface, which takes up to two minutes; by default only if it takes "
            "seconds.",
        ),
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
    service: ServiceOptions,
) -> None:
    """Open a result in a browser: one file with a viewer, which works offline."""
    import webbrowser

    from morph_engine import export as exports

    place = out or Path(tempfile.mkdtemp(prefix="morph-")) / f"{Path(result).stem}.html"
    selection = SelectionOptions(frames=frames, force=force, quiet=quiet)
    with _written_file(result, place, selection, service, format="html") as writing:
        chosen = parse_frames(frames)
        tracked = _surface_is_quick(writing.result, chosen) if surface is None else surface
        exports.export(
            writing.result, place, "html", frames=chosen, tracked=tracked, watch=writing.watch
        )
        if surface is None and not tracked:
            writing.tell(
                "Only particles are shown: --surface adds the surface, which takes up to two "
                "minutes."
            )
    if browser:
        webbrowser.open(place.absolute().as_uri())


@app.command(rich_help_panel=PANEL)
@expand_groups
def render(
    result: ResultArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            help="Output file: .gif, or with the extra video .mp4, .webm, .mov (ProRes); .png for "
            "one frame; .zip or a folder for one PNG file per frame.",
        ),
    ],
    *,
    color: Annotated[
        str | None,
        typer.Option(
            metavar="FIELD", help="Colour particles by a field, such as speed or target_distance."
        ),
    ] = None,
    turntable: Annotated[
        bool, typer.Option("--turntable", help="Short for --camera turn.")
    ] = False,
    camera: Annotated[
        Literal["still", "turn", "orbit"],
        typer.Option(
            help="The camera stays still, circles once, or circles while moving up and down."
        ),
    ] = "still",
    camera_key: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SHARE:AZIMUTH,ELEVATION[,ZOOM]",
            help="Camera position, in degrees, at a time from 0 to 1; repeat for several.",
        ),
    ] = None,
    background: Annotated[
        str, typer.Option(metavar="COLOUR", help="A name, #rrggbb, or transparent.")
    ] = "white",
    look: Annotated[
        str | None,
        typer.Option(help="Material: clay, porcelain, jelly, metal, wax or glass."),
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Pixels, up to 4096x4096.")] = "960x720",
    fps: Annotated[
        float | None,
        typer.Option(
            min=1, max=120, help="Frames per second; default: 12, or 30 with a playing time."
        ),
    ] = None,
    up: Annotated[
        Literal["y", "z"] | None,
        typer.Option(help="The upward axis; default: that of the source."),
    ] = None,
    playback: PlaybackOptions,
    selection: SelectionOptions,
    service: ServiceOptions,
) -> None:
    """Make a video of a result, or a picture of one of its frames."""
    from morph_engine.rendering.camera_path import CameraPath
    from morph_engine.rendering.pictures import video

    pixels, frames = parse_size(size), parse_frames(selection.frames)
    path_of_eye = CameraPath("turn" if turntable else camera, parse_camera_keys(camera_key or ()))
    timing = playback.timing(fps)
    with _written_file(result, out, selection, service) as writing:
        video(
            writing.result,
            out,
            field=color,
            surface=selection.surface,
            snap=selection.snap,
            size=pixels,
            fps=fps or VIDEO_FRAMES_PER_SECOND,
            frames=frames,
            up=up,
            timing=timing,
            camera=path_of_eye,
            background=background,
            material=look,
            watch=writing.watch,
        )


def _surface_is_quick(result: Path, frames: Sequence[int] | None) -> bool:
    from morph_engine.export.html import is_quick
    from morph_engine.results.trajectory import Trajectory

    with Trajectory(result) as trajectory:
        return is_quick(trajectory, frames)


def _format_by_suffix(out: Path, formats: dict[str, exports.Format]) -> str:
    for name, known in formats.items():
        if out.suffix.lower() == known.suffix != ".zip":  # which many formats may be in
            return name
    raise ConfigError(
        f"The name {out.name} does not tell the format.",
        f"Name one with --format: {', '.join(formats)}.",
    )


class Writing(NamedTuple):
    """What a file is written from, and who is told of it.

    Attributes:
        result: The result.
        watch: Shows how many frames are done.
        tell: Takes notes, which are printed at the end.
    """

    result: Path
    watch: Callable[[int, int], None]
    tell: Callable[[str], None]


@contextmanager
def _written_file(
    result: str, out: Path, selection: SelectionOptions, service: ServiceOptions, **more: str
) -> Iterator[Writing]:
    """Within, a file is written, of which Ctrl-C leaves nothing; its size and notes are printed."""
    check_output(out, force=selection.force, folder=True)
    quiet = selection.quiet or service.as_json
    notes: list[str] = []
    with (
        _local_file(result, service) as path,
        removing(out.absolute().parent, f"{escape(out.name)}.tmp*"),
        removing(out.absolute(), "frame-*.tmp"),  # where it is a folder
        ProgressDisplay(*Progress.get_default_columns(), quiet=quiet) as display,
    ):
        yield Writing(path, display.add_bar("frames"), notes.append)
    files = [out] if out.is_file() else sorted(out.iterdir())
    byte_count = sum(file.stat().st_size for file in files)
    service.print(
        {"out": str(out), "size_bytes": byte_count, "notes": notes, **more},
        "\n".join([*notes, f"{out} ({format_size(byte_count)})"]),
    )


@contextmanager
def _local_file(result: str, service: ServiceOptions) -> Iterator[Path]:
    """The result file, fetched from the service where a job is named."""
    from chamfer_morph.schemas.ids import is_id

    path = Path(result)
    if path.exists() or not is_id(result):
        yield path
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        removing(Path(folder).parent, Path(folder).name),
        service.connect() as client,
    ):
        fetched = Path(folder) / f"{result}.vtkhdf"
        client.download(result, fetched)
        yield fetched
