"""Export: frames of a result in the formats of other programs, one file each.

To add a format, write a module with a `FORMAT` and name it in `_ALL`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypedDict, get_args

from morph_engine.errors import ConfigError, ResultError, unknown_name
from morph_engine.export import csv, glb, html, npz, obj, pc2, ply, splat, stl, usd, video
from morph_engine.export.archive import write_archive, write_folder
from morph_engine.export.format import Format
from morph_engine.files import replacing
from morph_engine.rendering.picture_options import PictureOptions
from morph_engine.rendering.video_encoder import check_rate
from morph_engine.results.fields import find as find_field
from morph_engine.results.run_record import Units
from morph_engine.results.selection import Selection, check_snap, frame_list
from morph_engine.results.timeline import Timing
from morph_engine.results.trajectory import (
    Trajectory,
    check_replaces_no_result,
    opened,
    writing,
)

__all__ = [
    "FORMATS", "Content", "Format", "Selection", "Units", "check", "export", "find", "suffix",
]  # fmt: skip

LEAST_TEXTURE, LARGEST_TEXTURE = 64, 4096
"""Edge of a texture [pixels]."""

_ALL = (
    ply.FORMAT,
    obj.FORMAT,
    glb.FORMAT,
    stl.FORMAT,
    usd.FORMAT,
    pc2.FORMAT,
    npz.FORMAT,
    splat.FORMAT,
    csv.FORMAT,
    html.FORMAT,
)

_VIDEOS = (video.MP4, video.WEBM, video.MOV, video.GIF, video.PNG)

FORMATS: dict[str, Format] = {known.name: known for known in (*_ALL, *_VIDEOS)}


_OTHER_ENDINGS = {
    ".3mf", ".abc", ".blend", ".dae", ".fbx", ".gltf", ".jpeg", ".jpg", ".ksplat", ".off", ".png",
    ".splat", ".spz", ".usda", ".usdz", ".vtk", ".vtkhdf", ".vtp", ".webp", ".x3d", ".xyz",
}  # fmt: skip
"""Of files that are not written here, so that no folder is meant by them, either."""

_ENDINGS = {known.suffix for known in FORMATS.values()} | _OTHER_ENDINGS
"""What tells a reader that a file is of one format, and not of another."""


class Content(TypedDict):
    """What an export holds: arguments that `check` and `export` share."""

    frames: Sequence[int] | None
    surface: bool
    snap: bool
    tracked: bool
    texture: int | None
    fps: float | None
    timing: Timing | None
    picture: PictureOptions | None
    fields: Sequence[str]


def find(name: str) -> Format:
    """A format by its name.

    Raises:
        ConfigError: There is no such format.
    """
    if name not in FORMATS:
        raise unknown_name("export format", name, FORMATS)
    return FORMATS[name]


def suffix(format: str, frames: Sequence[int] | None, *, tracked: bool = False) -> str:
    """The ending of a file's name: that of the format, or ``.zip`` for several frames (None: all).

    A tracked surface is in one file.

    Raises:
        ConfigError: There is no such format.
    """
    chosen = find(format)
    several = frames is None or len(frames) != 1
    return ".zip" if chosen.kind == "frame" and several and not tracked else chosen.suffix


def export(
    result: Path | str | Trajectory,
    path: Path | str,
    format: str,
    *,
    frames: Sequence[int] | int | None = None,
    surface: bool = False,
    snap: bool = False,
    tracked: bool = False,
    texture: int | None = None,
    fps: float | None = None,
    timing: Timing | None = None,
    picture: PictureOptions | None = None,
    units: Units = "user",
    fields: Sequence[str] | str = (),
    watch: Callable[[int, int], None] = lambda done, total: None,
    tell: Callable[[str], None] = lambda sentence: None,
) -> Path:
    """Write frames of a result to a file, which is there as a whole or not at all; its path.

    A format of kind ``frame`` holds one frame in a file. Of several frames it makes a zip archive
    where the path ends in ``.zip``, and else a folder.

    Args:
        result: A result file, or one that is open.
        path: The file or folder to write. It must not end as files of another format do.
        format: Name of a format, see `FORMATS`.
        frames: Indices of the frames, or of a single one, negative from the end; None means all,
            and the last one where the path names a file for one frame.
        surface: A surface around the particles in place of the particles.
        snap: Draw the surface of the first and last frames to the meshes of source and target,
            where it is near to them.
        tracked: One mesh for all frames, whose triangles stay the same and whose vertices
            correspond, see `results.tracked_surface`. It is the surface.
        texture: Edge of the picture that holds the colours of a tracked surface [pixels], 64 to
            4096; None for colours at its corners.
        fps: Frames per second of an animation, 0.01 to 1000; 24 by default and 12 in videos.
        timing: Duration, rests, pace and repetition of a video, of a tracked surface or of a page,
            of all frames; it has frames per second of its own.
        picture: How pictures and videos are drawn; None for the usual way.
        units: ``user`` for the coordinates of the user's own files, from those of the source in the
            beginning to those of the target at the end; ``source`` or ``target`` for those of
            either all the time; ``grid`` for grid units.
        fields: Names of fields to carry along, or a single one, see `results.fields.FIELDS`. A
            surface takes them from the particle nearest to each of its vertices.
        watch: Called with the number of frames written and to be written.
        tell: Called with sentences on what was written that its reader should know.

    Raises:
        ConfigError: There is no such format, field or units, the format cannot hold what is asked
            for, the path is not one of that format, or there is no surface to draw.
        ExtraError: The format needs a package that is not installed.
        ResultError: The result is damaged, has no such frame or field, or would be replaced, or the
            disk refuses.
        MeshError: The particles of a frame enclose nothing.
    """
    chosen, path = find(format), Path(path)
    frames = frame_list(frames)
    fields = (fields,) if isinstance(fields, str) else tuple(fields)
    if units not in get_args(Units):
        raise ConfigError(
            f"There are no units called {units!r}.", f"Choose one of {', '.join(get_args(Units))}."
        )
    check(
        format,
        surface=surface,
        snap=snap,
        tracked=tracked,
        texture=texture,
        fields=fields,
        frames=frames,
        fps=fps,
        timing=timing,
        picture=picture,
    )
    check_replaces_no_result(result, path)
    _check_ending(chosen, path, tracked=tracked)
    single = chosen.kind == "frame" and path.suffix.lower() == chosen.suffix and not tracked
    with opened(result) as trajectory:
        selection = Selection(
            trajectory,
            _indices(trajectory, frames, only_last=single),
            surface=surface or tracked,
            snap=snap,
            tracked=tracked,
            texture=texture,
            fps=fps,
            timing=timing,
            picture=picture,
            units=units,
            fields=fields,
            watch=watch,
            tell=tell,
        )
        count = len(selection.frames)
        if single and count > 1:
            raise ConfigError(
                f"A {chosen.suffix} file holds one frame, but {count} were requested.",
                "Name a file that ends in .zip, or a folder.",
            )
        with writing(path):
            _write(chosen, selection, path)
    return path


def _write(chosen: Format, selection: Selection, path: Path) -> None:
    suffix = path.suffix.lower()
    one = selection.tracked or chosen.kind != "frame"
    if not one and suffix not in (chosen.suffix, ".zip"):
        return write_folder(chosen, selection, path)
    with replacing(path) as temporary:
        if not one and suffix == ".zip":
            write_archive(chosen, selection, temporary)
        else:
            chosen.write(selection, temporary)


def check(
    format: str,
    *,
    surface: bool = False,
    snap: bool = False,
    tracked: bool = False,
    texture: int | None = None,
    fields: Sequence[str] | str = (),
    frames: Sequence[int] | int | None = None,
    fps: float | None = None,
    timing: Timing | None = None,
    picture: PictureOptions | None = None,
) -> None:
    """Refuse what a format cannot hold, before anything is computed; arguments as for `export`.

    Raises:
        ConfigError: There is no such format or field, the format cannot hold it, or there is no
            surface to draw.
    """
    chosen = find(format)
    check_snap(surface=surface or tracked, snap=snap)
    for name in (fields,) if isinstance(fields, str) else fields:
        find_field(name)
    if tracked and fields:
        raise ConfigError("A tracked surface cannot have fields.", "Omit the fields, or `tracked`.")
    if texture is not None:
        _check_texture(format, texture, tracked=tracked)
    if picture:
        _check_picture(chosen, picture)
    rate = timing.fps if timing else fps
    if rate is not None:
        check_rate(format, rate)
    if timing and frames is not None:
        raise ConfigError(
            "With a playing time the whole run is shown, not selected frames.",
            "Omit the frames, or the options of the playing time.",
        )
    if timing and (not chosen.timed or (chosen.kind == "frame" and not tracked)):
        able = [name for name, known in FORMATS.items() if known.timed]
        raise ConfigError(
            f"{chosen.name} does not support a playing time.",
            f"Formats that do: {', '.join(able)}; glb only with a tracked surface.",
        )
    content = "tracked" if tracked else "surface" if surface else "points"
    wanted = {content} | ({"fields"} if fields else set())
    if wanted <= chosen.carries or (chosen.kind == "table" and not tracked):
        return
    if chosen.carries == {"surface"} and not tracked:
        raise ConfigError(
            f"{chosen.name} supports surfaces only.", "Request a surface, or use another format."
        )
    if chosen.carries == {"tracked"}:
        raise ConfigError(
            f"{chosen.name} supports tracked surfaces only.",
            "Request a tracked surface, or use another format.",
        )
    lacking = sorted(wanted - chosen.carries)[0]
    able = [name for name, known in FORMATS.items() if wanted <= known.carries]
    lacking = {"tracked": "tracked surfaces", "surface": "surfaces"}.get(lacking, lacking)
    raise ConfigError(
        f"{chosen.name} does not support {lacking}.", f"Formats that do: {', '.join(able)}."
    )


def _check_ending(chosen: Format, path: Path, *, tracked: bool) -> None:
    """Refuse the name of a file that would be taken for one of another format."""
    ending = path.suffix.lower()
    if tracked:
        if ending == chosen.suffix:
            return
        raise ConfigError(
            f"A tracked surface is written to a single {chosen.name} file, but "
            f"{path.name} is not one.",
            f"Name a file that ends in {chosen.suffix}.",
        )
    fitting = {chosen.suffix, ".zip"} if chosen.kind == "frame" else {chosen.suffix}
    if ending in _ENDINGS - fitting:
        several = "; for one file per frame, one that ends in .zip, or a folder"
        raise ConfigError(
            f"The name {path.name} contradicts the format {chosen.name}.",
            f"Name a file that ends in {chosen.suffix}{several * (chosen.kind == 'frame')}.",
        )


def _check_picture(format: Format, picture: PictureOptions) -> None:
    if "picture" not in format.carries:
        drawn = [name for name, known in FORMATS.items() if "picture" in known.carries]
        raise ConfigError(
            f"{format.name} stores geometry, not rendered pictures.",
            f"Rendered formats: {', '.join(drawn)}.",
        )
    picture.check(format.name)


def _check_texture(format: str, size: int, *, tracked: bool) -> None:
    if not LEAST_TEXTURE <= size <= LARGEST_TEXTURE:
        raise ConfigError(
            f"A texture width of {size} pixels is out of range.",
            f"Use {LEAST_TEXTURE} to {LARGEST_TEXTURE}.",
        )
    if "texture" not in find(format).carries or not tracked:
        raise ConfigError(
            "Textures are supported only for a tracked surface in a GLB.",
            "Request a tracked surface and the format glb, or omit the texture.",
        )


def _indices(
    trajectory: Trajectory, frames: Sequence[int] | None, *, only_last: bool
) -> tuple[int, ...]:
    if not trajectory.frame_count:
        raise ResultError(f"{trajectory.path} has no frames.", "Resume the run first.")
    if frames is None:
        return tuple(range(trajectory.frame_count))[-1 if only_last else 0 :]
    return tuple(dict.fromkeys(trajectory.index(frame) for frame in frames))
