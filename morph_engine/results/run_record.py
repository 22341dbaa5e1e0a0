"""What a run is made of: all that is needed to repeat it, written once when it starts."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import metadata
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from morph_engine.config import MorphConfig, stored_config
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.placement import Placement, Solid, place, placed
from morph_engine.geometry.point_cloud import median_gap, outer_radius
from morph_engine.geometry.sampling import Similarity

NEIGHBORS = 12
"""The neighbour whose distance tells how far particles stand apart."""

Json = dict[str, Any]
Role = Literal["source", "target"]
Units = Literal["user", "source", "target", "grid"]
"""Coordinates of results: those of the user's files, from the source's in the beginning to the
target's at the end (`Placement.to_user`); those of either all the time; or grid units."""

Shape = Mesh | NDArray[Any]
"""A shape as the user gave it: a mesh, or a bare point cloud of shape [n, 3]."""

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
    """The inputs of one run.

    Attributes:
        config: Resolved configuration.
        source: Source shape in the user's own coordinates.
        target: Target shape in the user's own coordinates.
        source_points: Particle positions before the first frame [dx], shape [n, 3], float32.
        target_points: Target points [dx], shape [m, 3], float32.
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
    def transform(self) -> NDArray[np.float64]:
        """Grid units to the target's coordinates, shape [4, 4], float64; acts on columns."""
        return self.placement.target.inverse().matrix

    def transform_to(self, units: Units, share: float) -> NDArray[np.float64]:
        """Grid units to other units at a share of the way, shape [4, 4], float64; acts on columns.

        The share is 0 for the source, and (i + 1) / n for frame i of n.
        """
        if units == "grid":
            return np.eye(4)
        if units == "user":
            return self.placement.to_user(share).matrix
        end: Similarity = getattr(self.placement, units)
        return end.inverse().matrix

    @property
    def radius(self) -> float:
        """Of the ball around the origin that holds both shapes [dx]."""
        return outer_radius(self.source_points, self.target_points)

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
        most = float(np.cbrt(len(self.target_points) / len(self.source_points)))
        if most <= 1:
            return spacing
        growth = median_gap(positions, NEIGHBORS) / self._source_gap
        return spacing * min(max(growth, 1.0), most)

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
        return json.loads(json.dumps(document))  # type: ignore[no-any-return]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of the record by name, each as it came in."""
        arrays: dict[str, NDArray[Any]] = {
            "source_points": self.source_points,
            "target_points": self.target_points,
        }
        for name, shape in (("source", self.source), ("target", self.target)):
            if isinstance(shape, Mesh):
                arrays[f"{name}_vertices"] = shape.vertices
                arrays[f"{name}_faces"] = shape.faces
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
        source, target = (_shape(role, document, arrays) for role in ("source", "target"))
        return cls(
            config=config,
            source=source,
            target=target,
            source_points=arrays["source_points"],
            target_points=arrays["target_points"],
            placement=Placement.model_validate(document["placement"])
            if "placement" in document
            else placement_of(source, target, config),
            preset=document["preset"],
            preset_version=document["preset_version"],
            seeds=document["seeds"],
            software=document["software"],
        )


def placement_of(source: Shape, target: Shape, config: MorphConfig) -> Placement:
    """Where two shapes are in the domain of a configuration."""
    solids = (Solid.of(shape) if isinstance(shape, Mesh) else None for shape in (source, target))
    return place(*solids, fit=config.sampling.fit, half_extent=config.domain)


def _identity(shape: Shape) -> dict[str, str]:
    if isinstance(shape, Mesh):
        return {"name": shape.name, "sha256": shape.sha256}
    digest = hashlib.sha256(f"{shape.dtype.str} {shape.shape} ".encode())
    digest.update(np.ascontiguousarray(shape).data)
    return {"name": "points", "sha256": digest.hexdigest()}


def _shape(name: str, document: Json, arrays: Mapping[str, NDArray[Any]]) -> Shape:
    vertices = arrays[f"{name}_vertices"]
    if f"{name}_faces" not in arrays:
        return vertices
    return Mesh(vertices=vertices, faces=arrays[f"{name}_faces"], **document[name])
