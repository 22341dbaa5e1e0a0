"""Pictures and videos of particles and surfaces, without a display."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from morph_engine import srgb
from morph_engine.errors import ConfigError, ResultError
from morph_engine.files import replacing
from morph_engine.geometry.point_cloud import ball_around, finite_points
from morph_engine.geometry.topology import vertex_normals
from morph_engine.geometry.upward import Up
from morph_engine.rendering import colormap, materials
from morph_engine.rendering.camera_path import AZIMUTH, ELEVATION, CameraPath
from morph_engine.rendering.contact_shadow import Ground
from morph_engine.rendering.picture_options import STILL, PictureOptions, background_color
from morph_engine.rendering.rasterizer import LARGE, Canvas
from morph_engine.rendering.video_encoder import (
    VideoKind,
    check_rate,
    write_picture,
    write_pictures,
    write_video,
)
from morph_engine.results.fields import FIELDS
from morph_engine.results.fields import find as find_field
from morph_engine.results.playback import Playback
from morph_engine.results.selection import Selection, check_snap, frame_list
from morph_engine.results.timeline import Timing
from morph_engine.results.trajectory import (
    Trajectory,
    check_replaces_no_result,
    opened,
    writing,
)

Floats = npt.NDArray[np.float64]
Size = tuple[int, int]

CLAY = (0.80, 0.78, 0.74)
PARTICLE_RADIUS_OVER_H = 0.55
"""Just over half the spacing: an even fill looks closed."""

OVERSAMPLING = 2
"""Pixels are drawn so many times finer, and averaged."""

SMOOTH_OVER_RADIUS = 3
"""Reach and depth of the mean that makes one surface of particles, in radii of theirs."""

MARGIN = 1.06
LEAST_REACH = 1e-6
"""Of a camera that looks at a single point [dx]."""

KINDS: dict[str, VideoKind] = {
    ".mp4": "mp4",
    ".webm": "webm",
    ".mov": "mov",
    ".gif": "gif",
    ".zip": "png",
}
WHITE = (1.0, 1.0, 1.0)
LEAST_COVER = 1e-6
TURN = CameraPath("turn")
THUMBNAIL_QUALITY = 85
THUMBNAIL = (240, 180)
THUMBNAIL_LOOK = "clay"
"""That of the page, unless somebody chooses another."""

HOLD_SECONDS = 1.0
"""How long a video rests on its last frame."""


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye infinitely far away.

    Attributes:
        rotation: From the domain to the eye, which looks along -z with y upwards, shape [3, 3].
        centre: What the picture's centre shows [dx], shape [3].
        reach: What the picture shows from its centre to its nearer edges [dx].
        up: The domain's upward axis, from where the light comes; None: that nearest to the eye's.
    """

    rotation: Floats
    centre: Floats
    reach: float
    up: Up | None = None

    @classmethod
    def facing(
        cls, points: npt.ArrayLike, rotation: Floats, size: Size, *, least: float = 0.0
    ) -> Camera:
        """A camera that shows all points.

        Args:
            points: Positions [dx], shape [n, 3]; those not finite are overlooked.
            rotation: From the domain to the eye, shape [3, 3], see `look`.
            size: Width and height of the picture [pixels].
            least: It shows no less than this from the centre to the nearer edges [dx]. Give the
                spacing of particles, which have a size even where they all lie in one place.
        """
        seen, _ = finite_points(points)
        if not len(seen):
            return cls(rotation, np.zeros(3), 1.0)
        seen = seen @ rotation.T
        lower, upper = seen.min(axis=0), seen.max(axis=0)
        half = (upper - lower)[:2] / 2 * min(size) / np.array(size)
        reach = MARGIN * max(float(half.max()), least, LEAST_REACH)
        return cls(rotation, (lower + upper) / 2 @ rotation, reach)

    @classmethod
    def around(
        cls, points: npt.ArrayLike, rotation: Floats, size: Size, *, least: float = 0.0
    ) -> Camera:
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
        half = half * min(size) / np.array(size)
        reach = MARGIN * max(float(half.max()), least, LEAST_REACH)
        return cls(rotation, centre, reach)

    @classmethod
    def anywhere(cls, points: npt.ArrayLike, rotation: Floats, *, least: float = 0.0) -> Camera:
        """A camera that shows all points from wherever it looks; arguments as for `facing`."""
        centre, radius = ball_around(points)
        return cls(rotation, centre, MARGIN * max(radius, least, LEAST_REACH))

    def seen(self, points: npt.ArrayLike, size: Size) -> npt.NDArray[np.float32]:
        """Positions in pixels from the picture's centre, shape [n, 3], float32."""
        apart = np.asarray(points, np.float64) - self.centre
        return (apart @ self.rotation.T * self.pixels(size)).astype(np.float32)

    def pixels(self, size: Size) -> float:
        """Pixels in one dx."""
        return min(size) / (2 * self.reach)


def look(*, azimuth: float = AZIMUTH, elevation: float = ELEVATION, up: Up = "y") -> Floats:
    """Rotation from the domain to an eye that looks along -z with y upwards.

    Args:
        azimuth: Turn about the upward axis [degrees]: 0 is the front, where z is nearest, or -y if
            z points upwards; 90 is the side where x is.
        elevation: Height of the eye above the horizon [degrees].
        up: The domain's upward axis.

    Returns:
        Orthogonal matrix, shape [3, 3], float64.
    """
    ca, sa = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    ce, se = np.cos(np.radians(elevation)), np.sin(np.radians(elevation))
    turn = np.array([[ca, 0, -sa], [0, 1, 0], [sa, 0, ca]])
    tilt = np.array([[1, 0, 0], [0, ce, -se], [0, se, ce]])
    rotation: Floats = tilt @ turn @ _upright(up)
    return rotation


def _upright(up: Up) -> Floats:
    """Rotation that brings the domain's upward axis to y, shape [3, 3].

    Where z points upwards the front is that of -y, as in the page and in Blender.
    """
    return np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) if up == "z" else np.eye(3)


def height_colors(source: npt.ArrayLike, view: Floats, *, palette: str = colormap.HEIGHT) -> Floats:
    """A colour per particle by its height in the source, so that one sees where matter goes.

    Args:
        source: Positions [dx], shape [n, 3].
        view: Rotation from the domain to the eye, shape [3, 3].
        palette: A colour map of cmap, which has those of Matplotlib.

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
    background: tuple[float, float, float] | None = WHITE,
    material: str | None = None,
    ground: Ground | None = None,
    smooth: bool = False,
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
        background: RGB, 0 to 1; None for a transparent one.
        material: A name of `materials.MATERIALS`; plain matter under one lamp when not given.
        ground: What it casts a soft shadow on, if on anything.
        smooth: Show particles as one smooth surface, coarser and cheaper than a reconstructed one.

    Returns:
        RGB, shape [height, width, 3], uint8; on a transparent background RGBA, [height, width, 4].
    """
    points = np.asarray(positions, np.float64)
    if colors is None and values is not None:
        low, high = limits or colormap.limits(values, diverging=diverging)
        name = colormap.DIVERGING if diverging else colormap.SEQUENTIAL
        colors = colormap.colors(values, low, high, palette=name)
    camera = view or Camera.facing(points, look(), size, least=spacing)
    image = _painted(points, spacing, colors, faces, camera, size, material, background, smooth)
    hidden = _shadow(ground, points, spacing, faces, camera, size) if ground else 0
    if background is None:
        image[..., 3] += (1 - image[..., 3]) * hidden
        image[..., :3] /= np.maximum(image[..., 3:], LEAST_COVER)
        return _as_bytes(image)
    rgb, cover = image[..., :3], image[..., 3]
    behind = ((1 - cover) * (1 - hidden))[..., None]
    return _as_bytes(rgb + behind * np.array(background, np.float32))


def _ground(points: npt.ArrayLike, spacing: float, up: Up) -> Ground:
    """The ground below particles, as wide as one of them where they all lie in one place."""
    ground = Ground.below(points, up)
    return replace(ground, radius=max(ground.radius, spacing))


def _shadow(
    ground: Ground,
    points: Floats,
    spacing: float,
    faces: npt.NDArray[np.int32] | None,
    camera: Camera,
    size: Size,
) -> npt.NDArray[np.float32]:
    """How far the shadow of a shape hides the background, shape [height, width]."""
    shadow = ground.shadow(points, PARTICLE_RADIUS_OVER_H * spacing, faces)
    pixel = 1 / camera.pixels(size)
    return ground.seen(shadow, camera.rotation, camera.centre, pixel, size)


def _as_bytes(image: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    drawn: npt.NDArray[np.uint8] = np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
    return drawn


def thumbnail(
    positions: npt.ArrayLike,
    spacing: float,
    colors: npt.NDArray[np.uint8] | None = None,
    up: Up = "y",
) -> bytes:
    """A small picture of particles as clay, with its shadow, on a transparent background.

    It is a WebP file of 240 x 180 pixels, a sixth of a PNG file in size.

    Args:
        positions: Of the particles [dx], shape [n, 3].
        spacing: Their lattice spacing h [dx].
        colors: Their colours, sRGB, shape [n, 3], uint8, if they have any.
        up: The axis that points upwards in the picture.
    """
    ground = _ground(positions, spacing, up)
    shown = np.concatenate([positions, ground.under(positions)])
    image = picture(
        positions,
        spacing=spacing,
        colors=None if colors is None else colors / 255,
        view=Camera.facing(shown, look(up=up), THUMBNAIL, least=spacing),
        size=THUMBNAIL,
        background=None,
        material=THUMBNAIL_LOOK,
        ground=ground,
        smooth=True,
    )
    file = io.BytesIO()
    Image.fromarray(image).save(file, "WEBP", quality=THUMBNAIL_QUALITY)
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
    frames: Sequence[int] | int | None = None,
    up: Up | None = None,
    kind: VideoKind | None = None,
    timing: Timing | None = None,
    camera: CameraPath = STILL,
    background: str = "white",
    material: str | None = None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write a video of a result.

    Without a timing it has a picture per frame and rests for a second on the last one.

    Args:
        result: A result file, or one that is open.
        path: The file to write, and to return. A path without an ending is a folder of PNG files,
            and one that ends in .png a picture of one frame, the last if none is named.
        field: Field to colour by, see `results.fields.FIELDS`. By default all has the colours of
            the shapes; where these have none, particles keep the colour of their height in the
            source, and a surface is plain.
        turntable: Turn once around the shape; short for that camera path.
        surface: Show a surface in place of particles.
        snap: Draw the surface of the first and last frames to the meshes of source and target,
            where it is near to them.
        size: Width and height [pixels], even numbers up to 4096.
        fps: Frames per second, 0.01 to 1000, without a timing.
        frames: Indices of the frames, or of a single one; None means all.
        up: The upward axis; None for that of the source.
        kind: ``mp4``, ``webm`` (VP9), ``mov`` (ProRes 4444), ``gif``, or ``png`` for a file per
            picture in a zip archive; by the path's ending when not given.
        timing: Duration, rests, pace and repetition, apart from the frames there are: all from the
            source on, and what lies between frames.
        camera: The path of the eye.
        background: A colour, or ``transparent`` for PNG, WebM and ProRes.
        material: A name of `materials.MATERIALS`, for what has no colours of its own and for how
            all shines, with a soft shadow on the ground; plain matter under one lamp when not
            given.
        watch: Called with the number of pictures drawn and to be drawn.

    Raises:
        ConfigError: The kind, the size, the field, the background, the material or the timing is
            none that can be used, or there is no surface to draw.
        ExtraError: A video is asked for that PyAV writes, which is not installed.
        ResultError: The result is damaged, lacks a frame or the field, or would be replaced.
        MeshError: The particles of a frame enclose nothing.
    """
    path, frames = Path(path), frame_list(frames)
    check_replaces_no_result(result, path)
    folder = not path.suffix and kind in (None, "png")
    still = path.suffix.lower() == ".png" and kind is None
    if still:
        frames = _one_frame(path, frames, timing)
    chosen = "png" if folder or still else kind or KINDS.get(path.suffix.lower())
    if chosen is None:
        raise ConfigError(
            f"The name {path.name} does not tell the kind of video.",
            "Name a file that ends in .mp4, .webm, .mov or .gif; in .png for one frame; "
            "or in .zip, or a folder, for one PNG file per frame.",
        )
    options = PictureOptions(size, TURN if turntable else camera, background, material)
    options.check(chosen)
    check_rate(chosen, timing.fps if timing else fps)
    if timing and frames is not None:
        raise ConfigError(
            "With a playing time the whole run is shown, not selected frames.",
            "Omit the frames, or the options of the playing time.",
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
        playback = Playback(trajectory, timing) if timing else None
        pictures = _pictures(
            selection,
            playback,
            options=options,
            up=up or trajectory.run.placement.up,
        )
        if not timing:
            pictures = _resting(pictures, round(HOLD_SECONDS * fps))
        with writing(path):
            if folder:
                write_pictures(path, pictures)
            elif still:
                with replacing(path) as temporary:
                    write_picture(temporary, next(pictures))
            else:
                with replacing(path) as temporary:
                    rate = timing.fps if timing else fps
                    write_video(temporary, pictures, kind=chosen, fps=rate)
    return path


def _one_frame(path: Path, frames: Sequence[int] | None, timing: Timing | None) -> Sequence[int]:
    """The frame of a single picture.

    Raises:
        ConfigError: More than one is asked for.
    """
    if timing or (frames is not None and len(frames) != 1):
        raise ConfigError(
            f"{path.name} holds one picture, but several were requested.",
            "Request one frame, or name a file that ends in .zip for one PNG file per frame.",
        )
    return (-1,) if frames is None else frames


def _resting(
    pictures: Iterator[npt.NDArray[np.uint8]], count: int
) -> Iterator[npt.NDArray[np.uint8]]:
    """All pictures, and the last one so many times more."""
    for last in pictures:
        yield last
    for _ in range(count):
        yield last


def _pictures(
    selection: Selection,
    playback: Playback | None,
    *,
    options: PictureOptions,
    up: Up,
) -> Iterator[npt.NDArray[np.uint8]]:
    """A picture per frame of the selection, or per moment of a playback."""
    trajectory = selection.trajectory
    run = trajectory.run
    ends = (trajectory.positions(selection.frames[0]), trajectory.positions(selection.frames[-1]))
    shown = np.concatenate([*ends, *run.via_points, run.target_points])
    if playback:
        shown = np.concatenate([shown, run.source_points])
    spacing = run.config.spacing
    ground = _ground(shown, spacing, up) if options.material else None
    if ground:  # room for the shadow of a surface, which reaches farther down than its particles
        lowest = replace(ground, level=ground.level - run.spacing_of(ends[-1]))
        shown = np.concatenate([shown, lowest.under(shown)])
    eye = _first_eye(shown, spacing, options.camera, options.size, up)
    background = background_color(options.background)
    (name,) = selection.fields or (None,)
    diverging = name is not None and FIELDS[name].diverging
    limits = _limits(selection, name) if name else None
    colors = None
    if not (name or selection.surface or options.material):
        colors = height_colors(run.source_points, look(up=up))
    count = len(playback.moments) if playback else len(selection.frames)
    # the last picture of a film that is timed ends a turn, and shows what the first one does
    steps = count - 1 if playback else count
    snapshots = selection.played(playback) if playback else selection.snapshots()
    for done, snapshot in enumerate(snapshots):
        view = options.camera.at(done / steps)
        now = colors
        if snapshot.colors is not None and not name:
            now = snapshot.colors / 255
        elif playback and colors is not None:
            now = playback.values(playback.moments[done], colors)
        yield picture(
            snapshot.vertices,
            spacing=snapshot.spacing,
            values=snapshot.fields.get(name) if name else None,
            colors=now,
            limits=limits,
            diverging=diverging,
            faces=snapshot.faces,
            view=replace(
                eye,
                rotation=look(azimuth=view.azimuth, elevation=view.elevation, up=up),
                reach=eye.reach / view.zoom,
            ),
            size=options.size,
            background=background,
            material=options.material,
            ground=ground and ground.touched_by(snapshot.vertices),
        )


def _first_eye(
    shown: npt.NDArray[np.floating], spacing: float, path: CameraPath, size: Size, up: Up
) -> Camera:
    """A camera that has everything in the picture, wherever its path leads it."""
    if path == STILL:
        eye = Camera.facing(shown, look(up=up), size, least=spacing)
    elif path == TURN:
        eye = Camera.around(shown, look(up=up), size, least=spacing)
    else:
        eye = Camera.anywhere(shown, look(up=up), least=spacing)
    return replace(eye, up=up)


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
    material: str | None = None,
    background: tuple[float, float, float] | None = None,
    smooth: bool = False,
) -> npt.NDArray[np.float32]:
    """The shape alone, with what of the background passes through it.

    Returns:
        RGB times cover, and cover, shape [height, width, 4], float32, 0 to 1.
    """
    fine = (size[0] * OVERSAMPLING, size[1] * OVERSAMPLING)
    canvas, scale = Canvas(*fine), camera.pixels(fine)
    plain = np.full((len(points), 3), CLAY)
    rgb = np.asarray(plain if colors is None else colors, np.float32)
    if faces is None:
        finite = np.isfinite(points).all(axis=1)
        radius = max(PARTICLE_RADIUS_OVER_H * spacing * scale, 1.0)
        canvas.spheres(camera.seen(points[finite], fine), radius, rgb[finite])
        if smooth and radius <= LARGE:  # beyond, the mean would be flat
            canvas.smooth(round(SMOOTH_OVER_RADIUS * radius), SMOOTH_OVER_RADIUS * radius)
    else:
        normals = (vertex_normals(points, faces) @ camera.rotation.T).astype(np.float32)
        canvas.triangles(camera.seen(points, fine), normals, rgb, faces)
    covered = canvas.covered
    image = np.zeros((*covered.shape, 4), np.float32)
    if material is None:
        image[covered, :3] = canvas.lit(scale)[covered]
        image[covered, 3] = 1
    else:
        found = materials.find(material)
        lit = partial(
            Canvas.light,
            material=found,
            scale=scale,
            to_room=_room(camera),
            colored=colors is not None,
            radius=scale * ball_around(points)[1],
        )
        behind = np.zeros(4) if background is None else np.append(srgb.linear(background), 1.0)
        if found.transmission and faces is not None:  # its far side is seen from within
            far = Canvas(*fine)
            far.triangles(camera.seen(points, fine), -normals, rgb, faces[:, ::-1])
            scene = np.tile(behind.astype(np.float32), (*covered.shape, 1))
            scene[far.covered] = lit(far, behind=behind)
            behind = scene
        light = lit(canvas, behind=behind)
        shown = materials.shown(light[:, :3])
        image[covered, :3] = shown
        # a reflection is seen where nothing else is
        image[covered, 3] = np.maximum(light[:, 3], shown.max(axis=1))
    tiles = image.reshape(size[1], OVERSAMPLING, size[0], OVERSAMPLING, 4)
    return np.asarray(tiles.mean(axis=(1, 3)), np.float32)


def _room(camera: Camera) -> Floats:
    """Rotation from the eye to a room whose y is the domain's upward axis."""
    up = camera.up or ("z" if _upward(camera.rotation)[2] else "y")
    to_room: Floats = _upright(up) @ camera.rotation.T
    return to_room
