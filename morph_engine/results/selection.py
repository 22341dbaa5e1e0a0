"""What is exported: frames of a trajectory, in which coordinates, with which fields."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from morph_engine import srgb
from morph_engine.errors import ConfigError, MeshError
from morph_engine.geometry.surface_reconstruction import Surface, reconstruct_surface
from morph_engine.geometry.surface_snapping import snapped_to
from morph_engine.geometry.topology import vertex_normals
from morph_engine.results.colors import Passage, blended
from morph_engine.results.fields import field
from morph_engine.results.playback import Playback, stops
from morph_engine.results.run_record import Role, Units
from morph_engine.results.timeline import Timing
from morph_engine.results.trajectory import Trajectory
from morph_engine.smoothstep import smoothstep

if TYPE_CHECKING:
    from morph_engine.rendering.picture_options import PictureOptions

Positions = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]
Closing = Callable[[npt.ArrayLike, npt.ArrayLike], Positions]
"""How values of the particles in the last shape become those in the first, where a loop closes."""

ENDS = 0.1
"""Share of the frames, at either end, in which surfaces are drawn to the meshes. Method `flow` lets
the target rest in as many."""


def check_snap(*, surface: bool, snap: bool) -> None:
    """Refuse to draw particles to a mesh, arguments as for `Selection`.

    Raises:
        ConfigError: No surface is asked for.
    """
    if snap and not surface:
        raise ConfigError(
            "Only a surface can be snapped to the meshes, and none was requested.",
            "Request a surface (`surface`), or omit `snap`.",
        )


def frame_list(frames: Iterable[int] | int | None) -> tuple[int, ...] | None:
    """Indices of frames as a caller names them: several, a single one, or None for all.

    Raises:
        ConfigError: There are none.
    """
    if frames is None:
        return None
    try:
        chosen = tuple(frames)  # type: ignore[arg-type]
    except TypeError:  # a single one
        chosen = (frames,)  # type: ignore[assignment]
    if not chosen:
        raise ConfigError("No frame was requested.", "Request at least one.")
    return chosen


def known_points(positions: npt.NDArray[np.floating], frame: int) -> npt.NDArray[np.bool_]:
    """Which points of a frame, shape [n, 3], are not lost, shape [n].

    Raises:
        MeshError: All of them are.
    """
    known: npt.NDArray[np.bool_] = np.isfinite(positions).all(axis=1)
    if not known.any():
        raise MeshError(f"There are no particles in frame {frame}.", "Choose other frames.")
    return known


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One frame as it is exported.

    Attributes:
        frame: Its index; of a moment its number.
        vertices: Particles, or corners of the surface [units of the selection], shape [v, 3].
        faces: Vertex indices of the surface, shape [f, 3], int32; None for particles.
        fields: A value per vertex by field name, shape [v], float32.
        spacing: Lattice spacing h of the particles [units of the selection].
        colors: Colours of the vertices, sRGB, shape [v, 3], uint8; None where the shapes have none.
    """

    frame: int
    vertices: Positions
    faces: npt.NDArray[np.int32] | None
    fields: dict[str, Values]
    spacing: float
    colors: npt.NDArray[np.uint8] | None = None

    @property
    def normals(self) -> Positions:
        """Unit normals at the corners of the surface, shape [v, 3]; of particles none, [0, 3]."""
        if self.faces is None:
            return np.zeros((0, 3))
        return vertex_normals(self.vertices, self.faces)


@dataclass(frozen=True, eq=False)
class Selection:
    """Frames of a trajectory, and how they are wanted.

    Attributes:
        trajectory: The result.
        frames: Indices of the frames, each from 0.
        surface: Whether a surface takes the place of the particles.
        snap: Whether the surface is drawn to the user's own meshes, near source and target.
        tracked: Whether the surface has the same triangles in all frames, see `tracked_surface`.
        texture: Edge of the picture that holds the colours of a tracked surface [pixels]; None for
            colours at its corners.
        fps: Frames per second of an animation; None for what the format usually has.
        timing: How long it is played, and how; None for a time for each frame.
        picture: How pictures and videos are drawn; None for the usual way.
        units: Coordinates: ``user``, ``source``, ``target`` or ``grid``, see `Units`.
        fields: Names of the fields to carry along.
        watch: Called with the number of frames written and to be written.
        tell: Called with sentences on what was written that its reader should know.
    """

    trajectory: Trajectory
    frames: tuple[int, ...]
    surface: bool = False
    snap: bool = False
    tracked: bool = False
    texture: int | None = None
    fps: float | None = None
    timing: Timing | None = None
    picture: PictureOptions | None = None
    units: Units = "user"
    fields: tuple[str, ...] = ()
    watch: Callable[[int, int], None] = lambda done, total: None
    tell: Callable[[str], None] = lambda sentence: None

    def only(self, frame: int) -> Selection:
        """The same of one frame, unwatched."""
        return replace(self, frames=(frame,), watch=lambda done, total: None)

    def snapshots(self) -> Iterator[Snapshot]:
        """The frames one after the other, watched.

        Raises:
            ResultError: A frame is damaged, or lacks a field.
            MeshError: The particles of a frame enclose nothing.
        """
        for done, frame in enumerate(self.frames):
            self.watch(done, len(self.frames))
            yield self._snapshot(frame)
        self.watch(len(self.frames), len(self.frames))

    def transform(self, frame: int) -> Positions:
        """Grid units to the units of the selection in a frame, shape [4, 4]; acts on columns."""
        return self.trajectory.transform_at(frame, self.units)

    def placed(self, positions: npt.ArrayLike, frame: int) -> Positions:
        """Positions of a frame in the units of the selection, shape [n, 3], float64."""
        return _moved(positions, self.transform(frame))

    def placed_end(self, role: Role) -> Positions:
        """Source or target points in the units of the selection, shape [n, 3], float64."""
        run = self.trajectory.run
        if role == "source":
            return _moved(run.source_points, run.transform_to(self.units, 0.0))
        return _moved(run.target_points, run.transform_to(self.units, 1.0, run.leg_count - 1))

    def field(self, name: str, frame: int) -> Values:
        """A field of a frame, a value per particle, shape [n], float32.

        Raises:
            ResultError: The frame is damaged, or lacks the field.
        """
        trajectory = self.trajectory
        return field(
            name,
            positions=trajectory.positions(frame),
            previous=trajectory.positions(frame - 1) if frame and name == "speed" else None,
            source=trajectory.run.source_points,
            target=trajectory.run.target_points_of(trajectory.leg_of(frame)),
            det_f=trajectory.det_f(frame) if name == "det_f" else None,
            spacing=self._spacing(trajectory.leg_of(frame)),
            workers=-1,
        )

    def played(self, playback: Playback) -> Iterator[Snapshot]:
        """The moments of a playback one after the other, watched, with the number of each.

        Raises:
            ResultError: A frame is damaged, or lacks a field.
            MeshError: The particles of a moment enclose nothing.
        """
        field_of = lru_cache(4 * max(1, len(self.fields)))(self.field)
        begins = stops(self.trajectory)
        for number, moment in enumerate(playback.moments):
            self.watch(number, len(playback.moments))
            frames = playback.frames(moment)
            fields = {
                name: playback.values(
                    moment, sum(weight * field_of(name, frame) for frame, weight in frames)
                ).astype(np.float32)
                for name in self.fields
            }
            steps = moment.station - begins[moment.leg]
            positions = playback.positions(moment)
            close = partial(playback.closed, moment) if moment.closing else None
            yield self._drawn(number, positions, fields, moment.leg, steps, close)
        self.watch(len(playback.moments), len(playback.moments))

    def _snapshot(self, frame: int) -> Snapshot:
        trajectory = self.trajectory
        return self._drawn(
            frame,
            trajectory.positions(frame),
            {name: self.field(name, frame) for name in self.fields},
            trajectory.leg_of(frame),
            trajectory.frame_in_leg(frame) + 1,
        )

    def _drawn(
        self,
        number: int,
        positions: npt.NDArray[np.floating],
        fields: dict[str, Values],
        leg: int,
        steps: float,
        close: Closing | None = None,
    ) -> Snapshot:
        """What is exported of particles so many frames after the beginning of a leg."""
        trajectory = self.trajectory
        share = steps / trajectory.planned_frames_of(leg)
        transform = trajectory.run.transform_to(self.units, share, leg)
        apart = self._spacing(leg) * float(np.cbrt(np.linalg.det(transform[:3, :3])))
        if not self.surface:
            colors = self._particle_colors(leg, share, close)
            return Snapshot(number, _moved(positions, transform), None, fields, apart, colors)
        spacing = trajectory.run.spacing_of(positions)
        found = reconstruct_surface(positions, spacing)
        if self.snap:
            found = self._drawn_to_ends(found, leg, steps, spacing)
        if fields:
            finite = np.isfinite(positions).all(axis=1)
            _, nearest = cKDTree(positions[finite]).query(found.vertices, workers=-1)
            fields = {name: values[finite][nearest] for name, values in fields.items()}
        colors = None
        if trajectory.colors is not None:
            colors = self._passage(positions, leg, share, close).colors_at(found.vertices, spacing)
        placed = _moved(found.vertices, transform)
        return Snapshot(number, placed, found.faces, fields, apart, colors)

    def surface_colors(
        self, vertices: Positions, frame: int, spacing: float
    ) -> npt.NDArray[np.uint8] | None:
        """Colours of a surface in a frame, sRGB, shape [v, 3], uint8; None without any.

        Args:
            vertices: Its corners [dx], shape [v, 3].
            frame: Index of the frame.
            spacing: Lattice spacing h of the particles there [dx].
        """
        if self.trajectory.colors is None:
            return None
        return self.passage(frame).colors_at(vertices, spacing)

    def passage(self, frame: int) -> Passage:
        """What gives colours to a surface in a frame of shapes that have some."""
        return self._passage(self.trajectory.positions(frame), *self._progress(frame), None)

    def particle_colors(self, frame: int) -> npt.NDArray[np.uint8] | None:
        """Colours of the particles in a frame, sRGB, shape [n, 3], uint8; None without any."""
        leg, share = self._progress(frame)
        return self._particle_colors(leg, share, None)

    def color_share(self, frame: int) -> float:
        """Share of the colours of the shape to come in those of a frame, 0 to 1."""
        return smoothstep(self._progress(frame)[1])

    def _progress(self, frame: int) -> tuple[int, float]:
        """The leg of a frame, and the share of it that is done then."""
        trajectory = self.trajectory
        leg = trajectory.leg_of(frame)
        return leg, (trajectory.frame_in_leg(frame) + 1) / trajectory.planned_frames_of(leg)

    def _particle_colors(
        self, leg: int, share: float, close: Closing | None
    ) -> npt.NDArray[np.uint8] | None:
        if self.trajectory.colors is None:
            return None
        light = srgb.from_bytes(self.trajectory.colors)
        end = close(light[leg + 1], light[0]) if close else light[leg + 1]
        return srgb.to_bytes(blended(light[leg], end, share))

    def _passage(
        self,
        positions: npt.NDArray[np.floating],
        leg: int,
        share: float,
        close: Closing | None,
    ) -> Passage:
        trajectory = self.trajectory
        begin, end = (trajectory.positions_in_shape(stop) for stop in (leg, leg + 1))
        ahead = close(end, trajectory.run.source_points) if close else end
        return Passage(trajectory.run, leg, share, positions, begin, ahead)

    def drawn_to_ends(self, surface: Surface, frame: int, spacing: float) -> Surface:
        """A frame's surface drawn to the mesh of the end that it is near to, if there is one."""
        trajectory = self.trajectory
        steps = trajectory.frame_in_leg(frame) + 1
        return self._drawn_to_ends(surface, trajectory.leg_of(frame), steps, spacing)

    def _drawn_to_ends(self, surface: Surface, leg: int, steps: float, spacing: float) -> Surface:
        trajectory = self.trajectory
        count = trajectory.planned_frames_of(leg)
        frames_from: dict[Role, float] = {"source": steps}
        if trajectory.is_finished(leg):
            frames_from["target"] = count - steps
        for role, frames in frames_from.items():
            share = 1 - frames / (ENDS * count)
            mesh, _ = trajectory.run.leg(leg).fitted(role)
            if share > 0 and mesh is not None:
                surface = snapped_to(surface, mesh, share, spacing)
        return surface

    def _spacing(self, leg: int) -> float:
        """What is measured against in a leg: spacing of its particles where it begins [dx]."""
        return self.trajectory.run.leg(leg).config.spacing


def _moved(positions: npt.ArrayLike, matrix: Positions) -> Positions:
    """Positions, shape [n, 3], under an affine map, shape [4, 4], that acts on columns, float64."""
    moved: Positions = np.asarray(positions, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved
