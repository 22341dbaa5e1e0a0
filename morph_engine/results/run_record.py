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
from morph_engine.geometry.point_cloud import median_gap
from morph_engine.geometry.sampling import Similarity, fit_to_domain

NEIGHBORS = 12
"""The neighbour whose distance tells how far particles stand apart."""

Json = dict[str, Any]
Role = Literal["source", "target"]
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
        transform: Grid units to the user's coordinates, shape [4, 4], float64; acts on columns.
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
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    preset: str = ""
    preset_version: int = 0
    seeds: dict[str, int] = field(default_factory=dict)
    software: dict[str, str] = field(default_factory=software_versions)

    @property
    def particle_count(self) -> int:
        """Number of particles n."""
        return len(self.source_points)

    def to_user(self, positions: NDArray[Any]) -> NDArray[np.float64]:
        """Positions [dx], shape [n, 3], in the user's coordinates, float64."""
        placed: NDArray[np.float64] = positions @ self.transform[:3, :3].T + self.transform[:3, 3]
        return placed

    def fitted(self, role: Role) -> tuple[Mesh | None, Similarity]:
        """A shape's mesh as the run has placed it in the domain.

        Returns:
            The mesh [dx], None for a point cloud, and the map from user coordinates to grid units.
        """
        shape = getattr(self, role)
        if not isinstance(shape, Mesh):
            return None, Similarity()
        return fit_to_domain(shape, mode=self.config.sampling.fit)

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
            "transform": np.asarray(self.transform, np.float64).tolist(),
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
        return cls(
            config=stored_config(document["config"]),
            source=_shape("source", document, arrays),
            target=_shape("target", document, arrays),
            source_points=arrays["source_points"],
            target_points=arrays["target_points"],
            transform=np.array(document["transform"], np.float64),
            preset=document["preset"],
            preset_version=document["preset_version"],
            seeds=document["seeds"],
            software=document["software"],
        )


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
