"""What is exported: frames of a trajectory, in which coordinates, with which fields."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from morph_engine.errors import ConfigError
from morph_engine.geometry.surface_reconstruction import Surface, reconstruct_surface
from morph_engine.geometry.surface_snapping import snapped_to
from morph_engine.geometry.topology import vertex_normals
from morph_engine.results.fields import field
from morph_engine.results.run_record import Role, Units
from morph_engine.results.trajectory import Trajectory

Positions = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]

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
            "Only a surface can be drawn to the meshes (snap), and none is asked for.",
            "Ask for a surface (`surface`), or leave out `snap`.",
        )


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One frame as it is exported.

    Attributes:
        frame: Its index.
        vertices: Particles, or corners of the surface [units of the selection], shape [v, 3].
        faces: Vertex indices of the surface, shape [f, 3], int32; None for particles.
        fields: A value per vertex by field name, shape [v], float32.
        spacing: Lattice spacing h of the particles [units of the selection].
    """

    frame: int
    vertices: Positions
    faces: npt.NDArray[np.int32] | None
    fields: dict[str, Values]
    spacing: float

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
        fps: Frames per second of an animation; None for what the format usually has.
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
    fps: float | None = None
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
        return _moved(run.target_points, run.transform_to(self.units, 1.0))

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
            target=trajectory.target_points,
            det_f=trajectory.det_f(frame) if name == "det_f" else None,
            spacing=self._spacing,
            workers=-1,
        )

    def _snapshot(self, frame: int) -> Snapshot:
        positions = self.trajectory.positions(frame)
        fields = {name: self.field(name, frame) for name in self.fields}
        transform = self.transform(frame)
        apart = self._spacing * float(np.cbrt(np.linalg.det(transform[:3, :3])))
        if not self.surface:
            return Snapshot(frame, self.placed(positions, frame), None, fields, apart)
        spacing = self.trajectory.run.spacing_of(positions)
        found = reconstruct_surface(positions, spacing)
        if self.snap:
            found = self.drawn_to_ends(found, frame, spacing)
        if fields:
            finite = np.isfinite(positions).all(axis=1)
            _, nearest = cKDTree(positions[finite]).query(found.vertices, workers=-1)
            fields = {name: values[finite][nearest] for name, values in fields.items()}
        return Snapshot(frame, self.placed(found.vertices, frame), found.faces, fields, apart)

    def drawn_to_ends(self, surface: Surface, frame: int, spacing: float) -> Surface:
        """A frame's surface drawn to the mesh of the end that it is near to, if there is one."""
        trajectory = self.trajectory
        complete = trajectory.status == "complete"
        count = trajectory.planned_frame_count
        frames_from: dict[Role, int] = {"source": frame + 1}
        if complete:  # else the target has not been reached
            frames_from["target"] = count - 1 - frame
        for role, frames in frames_from.items():
            share = 1 - frames / (ENDS * count)
            mesh, _ = trajectory.run.fitted(role)
            if share > 0 and mesh is not None:
                surface = snapped_to(surface, mesh, share, spacing)
        return surface

    @property
    def _spacing(self) -> float:
        return self.trajectory.config.spacing


def _moved(positions: npt.ArrayLike, matrix: Positions) -> Positions:
    """Positions, shape [n, 3], under an affine map, shape [4, 4], that acts on columns, float64."""
    moved: Positions = np.asarray(positions, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved
