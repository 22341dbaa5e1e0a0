"""What a run is made of: all that is needed to repeat it, written once when it starts."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import metadata
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from morph_engine.config import MorphConfig, stored_config
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.mesh_colors import MeshColors
from morph_engine.geometry.placement import Placement, place, placed
from morph_engine.geometry.point_cloud import median_gap, outer_radius
from morph_engine.geometry.sampling import Similarity
from morph_engine.geometry.solid import Solid

NEIGHBORS = 12
"""The neighbour whose distance tells how far particles stand apart."""

Json = dict[str, Any]
Role = Literal["source", "target"]
Units = Literal["user", "source", "target", "grid"]
"""Coordinates of results: those of the user's files, from the source's in the beginning to the
target's at the end (`Placement.to_user`); those of either all the time; or grid units."""

Shape = Mesh | NDArray[Any]
"""A shape as the user gave it: a mesh, or a bare point cloud of shape [n, 3]."""

_COLORS = "colors_"
"""After a shape's name, in the names of arrays that are its colours."""

_SOFTWARE = ("chamfer-morph", "taichi", "numpy", "scipy", "libigl", "trimesh", "h5py")


def software_versions() -> dict[str, str]:
    """Versions of "python", "machine" and the distributions that the numbers of a run depend on."""
    versions = {"python": platform.python_version(), "machine": platform.machine()}
    for name in _SOFTWARE:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "absent"
    return versions


@dataclass(frozen=True, eq=False)
class RunRecord:
    """The inputs of one run, from a source to a target, or through other shapes on its way.

    The way from one shape to the next is a leg. It begins with the particles as the last one has
    ended, and is a run of its own in all else.

    Attributes:
        config: Resolved configuration.
        source: Source shape in the user's own coordinates.
        target: Target shape in the user's own coordinates.
        source_points: Particle positions before the first frame [dx], shape [n, 3], float32.
        target_points: Target points [dx], shape [m, 3], float32.
        via: Shapes between source and target in their order, in the user's own coordinates.
        via_points: Their points [dx], each of shape [m, 3], float32.
        placement: Where the shapes are in the domain, and how results come back from it.
        preset: Name of the preset the configuration came from.
        preset_version: Its version.
        seeds: Name of each random stream to its seed.
        software: Versions of the software that makes the numbers.
    """

    config: MorphConfig
    source: Shape
    target: Shape
    source_points: NDArray[np.float32]
    target_points: NDArray[np.float32]
    via: tuple[Shape, ...] = ()
    via_points: tuple[NDArray[np.float32], ...] = ()
    placement: Placement = field(default_factory=Placement)
    preset: str = ""
    preset_version: int = 0
    seeds: dict[str, int] = field(default_factory=dict)
    software: dict[str, str] = field(default_factory=software_versions)

    @property
    def particle_count(self) -> int:
        """Number of particles n."""
        return len(self.source_points)

    @property
    def stops(self) -> tuple[Shape, ...]:
        """All shapes in their order, from the source to the target."""
        return (self.source, *self.via, self.target)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all shapes in their order, "points" for a cloud."""
        return tuple(_identity(shape)["name"] for shape in self.stops)

    @property
    def colored(self) -> bool:
        """Whether any shape has colours."""
        return any(isinstance(shape, Mesh) and shape.colors is not None for shape in self.stops)

    @property
    def leg_count(self) -> int:
        """Number of legs."""
        return len(self.via) + 1

    @property
    def planned_frames(self) -> int:
        """Number of frames of all legs, unless one ends early."""
        return self.config.frames * self.leg_count

    @property
    def closed(self) -> bool:
        """Whether the last shape is the first one, at the same place."""
        return (
            _identity(self.source) == _identity(self.target)
            and self.placement.source == self.placement.target
        )

    def target_points_of(self, leg: int) -> NDArray[np.float32]:
        """Points of the shape that a leg leads to [dx], shape [m, 3], float32."""
        return (*self.via_points, self.target_points)[leg]

    def leg(self, index: int, start: NDArray[np.float32] | None = None) -> RunRecord:
        """A leg as a run of its own, whose lattice spacing is what its particles have by then.

        Args:
            index: Of the leg, from 0.
            start: Where its particles are in the beginning [dx], shape [n, 3], float32; the points
                of the shape that it leads from when not given.
        """
        if self.leg_count == 1:
            return self
        return replace(
            self,
            config=config_at(self.config, self._growths[index]),
            source=self.stops[index],
            target=self.stops[index + 1],
            source_points=(
                (self.source_points, *self.via_points)[index] if start is None else start
            ),
            target_points=self.target_points_of(index),
            via=(),
            via_points=(),
            placement=self.placement.of_leg(index),
        )

    @property
    def transform(self) -> NDArray[np.float64]:
        """Grid units to the target's coordinates, shape [4, 4], float64; acts on columns."""
        return self.placement.target.inverse().matrix

    def transform_to(self, units: Units, share: float, leg: int = 0) -> NDArray[np.float64]:
        """Grid units to other units at a share of a leg, shape [4, 4], float64; acts on columns.

        The share is 0 where the leg begins, and (i + 1) / n for its frame i of n.
        """
        if units == "grid":
            return np.eye(4)
        if units == "user":
            return self.placement.to_user(share, leg).matrix
        end: Similarity = getattr(self.placement, units)
        return end.inverse().matrix

    @property
    def radius(self) -> float:
        """Of the ball around the origin that holds all shapes [dx]."""
        return outer_radius(self.source_points, *self.via_points, self.target_points)

    @property
    def ratio(self) -> float:
        """Target points over particles."""
        return len(self.target_points) / len(self.source_points)

    def fitted(self, role: Role) -> tuple[Mesh | None, Similarity]:
        """A shape's mesh as the run has placed it in the domain.

        Returns:
            The mesh [dx], None for a point cloud, and the map from user coordinates to grid units.
        """
        shape, similarity = getattr(self, role), getattr(self.placement, role)
        return placed(shape, similarity) if isinstance(shape, Mesh) else None, similarity

    def spacing_of(self, positions: NDArray[Any]) -> float:
        """Spacing of a frame's particles [dx]: h, or more where a larger target spreads them.

        Args:
            positions: Positions of the frame [dx], shape [n, 3].
        """
        spacing = self.config.spacing
        most = max(self._growths)
        if most <= 1:
            return spacing
        growth = median_gap(positions, NEIGHBORS) / self._source_gap
        return spacing * min(max(growth, 1.0), most)

    @cached_property
    def _growths(self) -> list[float]:
        """Spacing that the particles have in each shape where they fill it, over h."""
        sizes = [len(points) for points in (*self.via_points, self.target_points)]
        return growths(self.particle_count, sizes)

    @cached_property
    def _source_gap(self) -> float:
        return median_gap(self.source_points, NEIGHBORS)

    def document(self) -> Json:
        """The record as JSON, with a name and a sha256 in place of each array.

        Two records with equal documents describe the same run.
        """
        document = {
            "config": self.config.model_dump(mode="json"),
            "preset": self.preset,
            "preset_version": self.preset_version,
            "seeds": self.seeds,
            "software": self.software,
            "transform": self.transform.tolist(),
            "placement": self.placement.model_dump(mode="json"),
            "source": _identity(self.source),
            "target": _identity(self.target),
            "source_points": _identity(self.source_points),
            "target_points": _identity(self.target_points),
        }
        if self.via:
            document["via"] = [_identity(shape) for shape in self.via]
            document["via_points"] = [_identity(points) for points in self.via_points]
        return json.loads(json.dumps(document))  # type: ignore[no-any-return]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of the record by name, each as it came in."""
        arrays: dict[str, NDArray[Any]] = {
            "source_points": self.source_points,
            "target_points": self.target_points,
        }
        for index, points in enumerate(self.via_points):
            arrays[f"via_{index}_points"] = points
        between = [(f"via_{index}", shape) for index, shape in enumerate(self.via)]
        for name, shape in (("source", self.source), *between, ("target", self.target)):
            if isinstance(shape, Mesh):
                arrays[f"{name}_vertices"] = shape.vertices
                arrays[f"{name}_faces"] = shape.faces
                if shape.colors:
                    colors = shape.colors.arrays()
                    arrays |= {f"{name}_{_COLORS}{key}": array for key, array in colors.items()}
            else:
                arrays[f"{name}_vertices"] = shape
        return arrays

    @classmethod
    def restore(cls, document: Json, arrays: Mapping[str, NDArray[Any]]) -> RunRecord:
        """The record whose `document()` and `arrays()` this version or an older one stored.

        Unknown keys of the document are ignored.

        Raises:
            KeyError: A part is missing.
        """
        config = stored_config(document["config"])
        source, target = (_shape(role, document[role], arrays) for role in ("source", "target"))
        between = document.get("via", [])
        return cls(
            config=config,
            source=source,
            target=target,
            source_points=arrays["source_points"],
            target_points=arrays["target_points"],
            via=tuple(_shape(f"via_{i}", each, arrays) for i, each in enumerate(between)),
            via_points=tuple(arrays[f"via_{i}_points"] for i in range(len(between))),
            placement=Placement.model_validate(document["placement"])
            if "placement" in document
            else placement_of(source, target, config),
            preset=document["preset"],
            preset_version=document["preset_version"],
            seeds=document["seeds"],
            software=document["software"],
        )


def placement_of(
    source: Shape, target: Shape, config: MorphConfig, via: Sequence[Shape] = ()
) -> Placement:
    """Where the shapes of a morph are in the domain of a configuration."""

    def solid(shape: Shape) -> Solid | None:
        return Solid.of(shape) if isinstance(shape, Mesh) else None

    return place(
        solid(source),
        solid(target),
        via=[solid(shape) for shape in via],
        fit=config.sampling.fit,
        half_extent=config.domain,
        poses=config.placement,
    )


def growths(particle_count: int, point_counts: Sequence[int]) -> list[float]:
    """Spacing of the particles in each shape of a morph, over that in the source.

    Args:
        particle_count: Number of particles n.
        point_counts: Number of points of each target, on the lattice that the particles have in
            the shape before it.
    """
    found = [1.0]
    for count in point_counts:
        found.append(found[-1] * float(np.cbrt(count / particle_count)))
    return found


def config_at(config: MorphConfig, growth: float) -> MorphConfig:
    """A configuration for particles whose spacing has become h times a factor.

    Their number per cell edge need not be whole.
    """
    if growth == 1:
        return config
    density = config.sampling.points_per_cell_edge / growth
    sampling = config.sampling.model_copy(update={"points_per_cell_edge": density})
    return config.model_copy(update={"sampling": sampling})


def _identity(shape: Shape) -> dict[str, str]:
    if isinstance(shape, Mesh):
        return {"name": shape.name, "sha256": shape.sha256}
    digest = hashlib.sha256(f"{shape.dtype.str} {shape.shape} ".encode())
    digest.update(np.ascontiguousarray(shape).data)
    return {"name": "points", "sha256": digest.hexdigest()}


def _shape(name: str, identity: Json, arrays: Mapping[str, NDArray[Any]]) -> Shape:
    vertices = arrays[f"{name}_vertices"]
    if f"{name}_faces" not in arrays:
        return vertices
    beginning = f"{name}_{_COLORS}"
    colors = {
        key.removeprefix(beginning): array
        for key, array in arrays.items()
        if key.startswith(beginning)
    }
    return Mesh(
        vertices=vertices,
        faces=arrays[f"{name}_faces"],
        colors=MeshColors.restore(colors) if colors else None,
        **identity,
    )
