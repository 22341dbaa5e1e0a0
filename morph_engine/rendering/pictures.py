"""Pictures and videos of particles and surfaces, without a display."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.spatial.transform import Rotation

from morph_engine.errors import ConfigError, ResultError
from morph_engine.files import replacing
from morph_engine.geometry.point_cloud import finite_points
from morph_engine.geometry.topology import vertex_normals
from morph_engine.rendering import colormap
from morph_engine.rendering.rasterizer import Canvas
from morph_engine.rendering.video_encoder import VideoKind, write_video
from morph_engine.results.fields import FIELDS
from morph_engine.results.fields import find as find_field
from morph_engine.results.selection import Selection, check_snap
from morph_engine.results.trajectory import Trajectory, opened, writing

Floats = npt.NDArray[np.float64]
Size = tuple[int, int]

CLAY = (0.80, 0.78, 0.74)
PARTICLE_RADIUS_OVER_H = 0.55
"""Just over half the spacing: an even fill looks closed."""

OVERSAMPLING = 2
"""Pixels are drawn so many times finer, and averaged."""

MARGIN = 1.06
KINDS: dict[str, VideoKind] = {".mp4": "mp4", ".gif": "gif"}
THUMBNAIL_QUALITY = 85
THUMBNAIL = (240, 180)
HOLD_SECONDS = 1.0
"""How long a video rests on its last frame."""


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye infinitely far away.

    Attributes:
        rotation: From the domain to the eye, which looks along -z with y upwards, shape [3, 3].
        centre: What the picture's centre shows [dx], shape [3].
        reach: What the picture shows from its centre to its nearer edges [dx].
    """

    rotation: Floats
    centre: Floats
    reach: float

    @classmethod
    def facing(cls, points: npt.ArrayLike, rotation: Floats, size: Size) -> Camera:
        """A camera that shows all points.

        Args:
            points: Positions [dx], shape [n, 3]; those not finite are overlooked.
            rotation: From the domain to the eye, shape [3, 3], see `look`.
            size: Width and height of the picture [pixels].
        """
        seen, _ = finite_points(points)
        if not len(seen):
            return cls(rotation, np.zeros(3), 1.0)
        seen = seen @ rotation.T
        lower, upper = seen.min(axis=0), seen.max(axis=0)
        half = (upper - lower)[:2] / 2 * min(size) / np.array(size)
        reach = MARGIN * max(float(half.max()), 1e-6)
        return cls(rotation, (lower + upper) / 2 @ rotation, reach)

    @classmethod
    def around(cls, points: npt.ArrayLike, rotation: Floats, size: Size) -> Camera:
        """A camera that shows all points while they turn about the axis that looks upright.

        Arguments as for `facing`.
        """
        array, _ = finite_points(points)
        if not len(array):
            return cls(rotation, np.zeros(3), 1.0)
        centre = (array.min(axis=0) + array.max(axis=0)) / 2
        upward = _upward(rotation)
        height = np.abs((array - centre) @ upward)
        aside = np.linalg.norm((array - centre) * (1 - upward), axis=1)
        tilt = float(np.arccos(np.clip(rotation[1] @ upward, -1, 1)))
        half = np.array([aside.max(), (height * np.cos(tilt) + aside * np.sin(tilt)).max()])
        reach = MARGIN * max(float((half * min(size) / np.array(size)).max()), 1e-6)
        return cls(rotation, centre, reach)

    def seen(self, points: npt.ArrayLike, size: Size) -> npt.NDArray[np.float32]:
        """Positions in pixels from the picture's centre, shape [n, 3], float32."""
        apart = np.asarray(points, np.float64) - self.centre
        return (apart @ self.rotation.T * self.pixels(size)).astype(np.float32)

    def pixels(self, size: Size) -> float:
        """Pixels in one dx."""
        return min(size) / (2 * self.reach)


def look(*, azimuth: float = 25.0, elevation: float = 15.0, up: Literal["y", "z"] = "y") -> Floats:
    """Rotation from the domain to an eye that looks along -z with y upwards.

    Args:
        azimuth: Turn about the upward axis [degrees].
        elevation: Height of the eye above the horizon [degrees].
        up: The domain's upward axis.

    Returns:
        Orthogonal matrix, shape [3, 3], float64.
    """
    ca, sa = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    ce, se = np.cos(np.radians(elevation)), np.sin(np.radians(elevation))
    turn = np.array([[ca, 0, -sa], [0, 1, 0], [sa, 0, ca]])
    tilt = np.array([[1, 0, 0], [0, ce, -se], [0, se, ce]])
    upright = np.eye(3)[[1, 2, 0]] if up == "z" else np.eye(3)
    rotation: Floats = tilt @ turn @ upright
    return rotation


def height_colors(source: npt.ArrayLike, view: Floats, *, palette: str = "turbo") -> Floats:
    """A colour per particle by its height in the source, so that one sees where matter goes.

    Args:
        source: Positions [dx], shape [n, 3].
        view: Rotation from the domain to the eye, shape [3, 3].
        palette: A colour map of Matplotlib.

    Returns:
        RGB, shape [n, 3], float64, 0 to 1.
    """
    height = np.asarray(source, np.float64) @ view[1]
    share = (height - height.min()) / max(float(np.ptp(height)), 1e-12)
    return colormap.colors(0.1 + 0.8 * share, 0.0, 1.0, palette=palette)


def picture(
    positions: npt.ArrayLike,
    *,
    spacing: float,
    values: npt.ArrayLike | None = None,
    colors: npt.ArrayLike | None = None,
    limits: tuple[float, float] | None = None,
    diverging: bool = False,
    faces: npt.NDArray[np.int32] | None = None,
    view: Camera | None = None,
    size: Size = (960, 720),
) -> npt.NDArray[np.uint8]:
    """Draw particles as small lit spheres, or a surface.

    Args:
        positions: Particles, or corners of the surface [dx], shape [n, 3]. Those not finite are
            left out.
        spacing: Lattice spacing h, for the size of a sphere [dx].
        values: A number for each of them, shape [n], to colour them by.
        colors: RGB for each of them, shape [n, 3], 0 to 1, in place of values.
        limits: Values of the palette's ends; the 1 and 99 % quantiles when not given.
        diverging: Use a palette whose middle is 1.
        faces: Vertex indices of the surface, shape [f, 3]; None for particles.
        view: The camera; one that shows everything when not given.
        size: Width and height [pixels].

    Returns:
        RGB, shape [height, width, 3], uint8.
    """
    points = np.asarray(positions, np.float64)
    if colors is None and values is not None:
        low, high = limits or colormap.limits(values, diverging=diverging)
        name = colormap.DIVERGING if diverging else colormap.SEQUENTIAL
        colors = colormap.colors(values, low, high, palette=name)
    camera = view or Camera.facing(points, look(), size)
    image = _painted(points, spacing, colors, faces, camera, size)
    rgb, cover = image[..., :3], image[..., 3:]
    blended = rgb + (1 - cover)  # on white
    drawn: npt.NDArray[np.uint8] = np.rint(255 * blended).astype(np.uint8)
    return drawn


def thumbnail(positions: npt.ArrayLike, spacing: float) -> bytes:
    """A picture of particles [dx], shape [n, 3], of lattice spacing h [dx] on a transparent ground.

    It is a WebP file of 240 x 180 pixels, a sixth of a PNG file in size.
    """
    points = np.asarray(positions, np.float64)
    camera = Camera.facing(points, look(), THUMBNAIL)
    image = _painted(points, spacing, None, None, camera, THUMBNAIL)
    image[..., :3] /= np.maximum(image[..., 3:], 1e-6)
    file = io.BytesIO()
    Image.fromarray(np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)).save(
        file, "WEBP", quality=THUMBNAIL_QUALITY
    )
    return file.getvalue()


def video(
    result: Path | str | Trajectory,
    path: Path | str,
    *,
    field: str | None = None,
    turntable: bool = False,
    surface: bool = False,
    snap: bool = False,
    size: Size = (960, 720),
    fps: float = 12.0,
    frames: Sequence[int] | None = None,
    up: Literal["y", "z"] = "y",
    kind: VideoKind | None = None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write a video of a result; it rests for a second on the last frame.

    Args:
        result: A result file, or one that is open.
        path: The file to write, and to return.
        field: Field to colour by, see `results.fields.FIELDS`. By default particles keep the
            colour of their height in the source, and a surface is plain.
        turntable: Turn once around the shape.
        surface: Show a surface in place of particles.
        snap: Draw the surface of the first and last frames to the meshes of source and target,
            where it is near to them.
        size: Width and height [pixels], even numbers.
        fps: Frames per second.
        frames: Indices of the frames; None means all.
        up: The upward axis.
        kind: ``mp4`` or ``gif``; by the path's ending when not given.
        watch: Called with the number of pictures drawn and to be drawn.

    Raises:
        ConfigError: The kind, the size or the field is none that can be used, or there is no
            surface to draw.
        ExtraError: An MP4 is asked for, and the package that writes it is not installed.
        ResultError: The result is damaged, or lacks a frame or the field.
        MeshError: The particles of a frame enclose nothing.
    """
    path = Path(path)
    chosen = kind or KINDS.get(path.suffix.lower())
    if chosen is None:
        raise ConfigError(
            f"{path.name} says no kind of video.", "Name a file that ends in .mp4 or .gif."
        )
    if min(size) < 16 or max(size) > 4096 or size[0] % 2 or size[1] % 2:
        raise ConfigError(
            f"A video cannot have {size[0]} x {size[1]} pixels.",
            "Use even numbers from 16 to 4096, such as 960x720.",
        )
    if field:
        find_field(field)
    check_snap(surface=surface, snap=snap)
    with opened(result) as trajectory:
        if not trajectory.frame_count:
            raise ResultError(f"{trajectory.path} has no frames.", "Resume the run first.")
        selection = Selection(
            trajectory,
            tuple(
                range(trajectory.frame_count) if frames is None else map(trajectory.index, frames)
            ),
            surface=surface,
            snap=snap,
            units="grid",
            fields=(field,) if field else (),
            watch=watch,
        )
        pictures = _pictures(selection, look(up=up), size, turntable=turntable)
        held = _resting(pictures, round(HOLD_SECONDS * fps))
        with writing(path), replacing(path) as temporary:
            write_video(temporary, held, kind=chosen, fps=fps)
    return path


def _resting(
    pictures: Iterator[npt.NDArray[np.uint8]], count: int
) -> Iterator[npt.NDArray[np.uint8]]:
    """All pictures, and the last one so many times more."""
    for last in pictures:
        yield last
    for _ in range(count):
        yield last


def _pictures(
    selection: Selection, rotation: Floats, size: Size, *, turntable: bool
) -> Iterator[npt.NDArray[np.uint8]]:
    trajectory = selection.trajectory
    source = trajectory.run.source_points
    ends = (trajectory.positions(selection.frames[0]), trajectory.positions(selection.frames[-1]))
    shown = np.concatenate([*ends, trajectory.target_points])
    frame = Camera.around if turntable else Camera.facing
    camera = frame(shown, rotation, size)
    (name,) = selection.fields or (None,)
    diverging = name is not None and FIELDS[name].diverging
    limits = _limits(selection, name) if name else None
    colors = None if name or selection.surface else height_colors(source, rotation)
    for done, snapshot in enumerate(selection.snapshots()):
        turned = _turn(rotation, done / len(selection.frames)) if turntable else rotation
        yield picture(
            snapshot.vertices,
            spacing=snapshot.spacing,
            values=snapshot.fields.get(name) if name else None,
            colors=colors,
            limits=limits,
            diverging=diverging,
            faces=snapshot.faces,
            view=replace(camera, rotation=turned),
            size=size,
        )


def _turn(rotation: Floats, share: float) -> Floats:
    """A rotation after a share of a full turn about the axis that looks upright."""
    turn: Floats = Rotation.from_rotvec(2 * np.pi * share * _upward(rotation)).as_matrix()
    return rotation @ turn


def _upward(rotation: Floats) -> Floats:
    """The domain's axis that looks upright, shape [3]."""
    upward: Floats = np.eye(3)[np.argmax(np.abs(rotation[1]))]
    return upward


def _limits(selection: Selection, name: str) -> tuple[float, float]:
    """One range for the whole video, from its first, middle and last frame."""
    frames = selection.frames
    some = {frames[0], frames[len(frames) // 2], frames[-1]}
    values = np.concatenate([selection.field(name, frame) for frame in some])
    return colormap.limits(values, diverging=FIELDS[name].diverging)


def _painted(
    points: Floats,
    spacing: float,
    colors: npt.ArrayLike | None,
    faces: npt.NDArray[np.int32] | None,
    camera: Camera,
    size: Size,
) -> npt.NDArray[np.float32]:
    """The shape alone: RGB times cover, and cover, shape [height, width, 4], float32, 0 to 1."""
    fine = (size[0] * OVERSAMPLING, size[1] * OVERSAMPLING)
    canvas, scale = Canvas(*fine), camera.pixels(fine)
    plain = np.full((len(points), 3), CLAY)
    rgb = np.asarray(plain if colors is None else colors, np.float32)
    if faces is None:
        finite = np.isfinite(points).all(axis=1)
        radius = max(PARTICLE_RADIUS_OVER_H * spacing * scale, 1.0)
        canvas.spheres(camera.seen(points[finite], fine), radius, rgb[finite])
    else:
        normals = (vertex_normals(points, faces) @ camera.rotation.T).astype(np.float32)
        canvas.triangles(camera.seen(points, fine), normals, rgb, faces)
    cover = canvas.covered[..., None].astype(np.float32)
    image = np.concatenate([canvas.lit(scale) * cover, cover], axis=2)
    tiles = image.reshape(size[1], OVERSAMPLING, size[0], OVERSAMPLING, 4)
    return np.asarray(tiles.mean(axis=(1, 3)), np.float32)
