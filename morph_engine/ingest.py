"""The first look at a user's mesh: can it be filled with particles, and what will that cost?"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field

from morph_engine.cost import Estimate, estimate
from morph_engine.errors import MeshError
from morph_engine.geometry.automatic_fit import LARGEST_FACTOR, fit_alone, reach_in
from morph_engine.geometry.mesh import TEXT_PREFIX, Mesh
from morph_engine.geometry.placement import place, placed
from morph_engine.geometry.point_cloud import outer_radius
from morph_engine.geometry.sampling import (
    HALF_EXTENT,
    MINIMUM_PARTICLES,
    REFERENCE_VOLUME,
    Fit,
    sample_lattice,
    size_remedy,
)
from morph_engine.geometry.solid import Solid
from morph_engine.geometry.topology import Opening, Topology, Vector
from morph_engine.geometry.upward import Up
from morph_engine.geometry.winding_number import winding_number
from morph_engine.presets import configure
from morph_engine.sections import MOST_CELLS

POINTS_PER_CELL_EDGE = (2, 3, 4)

LEAST_VOLUME = MINIMUM_PARTICLES / POINTS_PER_CELL_EDGE[-1] ** 3
"""Of a mesh that has room for enough particles [grid units^3]."""

SLACK = 1.05
"""A mesh is scaled by so much more, since a lattice has seldom as many points as volume."""

VOLUME_REMEDY = "To have it scaled and centred, set `sampling.fit` to volume."

AMBIGUOUS_LIMIT = 0.05
"""Largest share of ambiguous points in a mesh that bounds a volume; the Stanford bunny has .007."""

AMBIGUOUS_DISTANCE = 0.25
"""Distance of a winding number from the nearest integer that makes its point ambiguous."""

FRAMES = 40
"""Frames of the run whose cost is estimated."""

PROBE_COUNT = 20_000
PROBES_PER_AXIS = 64
PROBE_PHASE = (0.5 + 0.1 * (2**0.5 - 1), 0.5 + 0.1 * (3**0.5 - 1), 0.5 + 0.1 * (5**0.5 - 2))
"""Where in a cell of the lattice a point is that is asked for its winding number: irrational."""


class Resolution(BaseModel, frozen=True):
    """What a run costs at one number of particles per cell edge."""

    points_per_cell_edge: int
    particle_count: int = Field(description="Particles on the published lattice")
    estimate: Estimate = Field(description="Cost of a run against a target of the usual size")


class IngestReport(BaseModel, frozen=True):
    """What the engine sees in a mesh; lengths in the mesh's coordinates."""

    name: str
    sha256: str
    vertex_count: int
    face_count: int
    watertight: bool = Field(
        description="Whether every edge joins two faces of consistent orientation"
    )
    component_count: int = Field(description="Parts that share no vertex")
    euler: int = Field(description="Vertices - edges + faces, equal positions welded")
    open_edge_count: int = Field(description="Number of edges along which the surface is open")
    openings: tuple[Opening, ...] = Field(description="The largest openings, at most ten")
    ambiguous_winding: float = Field(
        description="Share of points that are neither inside nor outside"
    )
    volume: float = Field(description="Enclosed volume; overlapping parts count twice")
    bounds: tuple[Vector, Vector] = Field(description="Corners of the bounding box")
    colors: Literal["none", "corners", "textures"] = Field(
        "none", description="Where its colours are stored, if it has any"
    )
    up: Up | None = Field(None, description="Upward axis according to the file; null if unknown")
    fits_domain: bool = Field(description="Whether it lies in the usable cube as it is")
    resolutions: tuple[Resolution, ...] = Field(
        description="Empty unless the mesh can be used with the requested placement"
    )
    placement: str = Field(description="How it was placed for that; empty if it was not moved")
    warnings: tuple[str, ...]


def fitted(mesh: Mesh, fit: Fit) -> tuple[Mesh, str]:
    """A mesh as a run between shapes like it places it, and what `auto` does to it in words."""
    solid = Solid.of(mesh)
    placement = place(solid, solid, fit=fit)
    return placed(mesh, placement.source), placement.message


def inspect_mesh(mesh: Mesh, *, fit: Fit = "auto") -> IngestReport:
    """Describe a mesh. Whether it can be used is for `check_mesh` to say.

    Args:
        mesh: Mesh in its own coordinates.
        fit: How a run would place it, as `sampling.fit`; its resolutions are those of that.
    """
    in_domain, message = fitted(mesh, fit)
    topology = Topology(mesh.vertices, mesh.faces)
    ambiguous = ambiguous_winding(mesh)
    usable = _problem(in_domain, ambiguous, HALF_EXTENT, mesh) is None
    cavities = np.count_nonzero(topology.component_volumes < 0)
    warnings = mesh.repairs
    if not topology.watertight:
        warnings += ("The surface is not watertight; winding numbers decide what is inside.",)
    if cavities:
        warnings += (f"{cavities} inverted part(s) are treated as cavities.",)
    lower, upper = mesh.bounds.tolist()
    return IngestReport(
        name=mesh.name,
        sha256=mesh.sha256,
        vertex_count=len(mesh.vertices),
        face_count=len(mesh.faces),
        watertight=topology.watertight,
        component_count=topology.component_count,
        euler=topology.euler,
        open_edge_count=len(topology.open_edges),
        openings=topology.openings[:10],
        ambiguous_winding=ambiguous,
        volume=mesh.volume,
        bounds=(tuple(lower), tuple(upper)),
        colors=_place_of_colors(mesh),
        up=mesh.up,
        fits_domain=_fits(mesh, HALF_EXTENT),
        resolutions=tuple(_resolution(in_domain, n) for n in POINTS_PER_CELL_EDGE if usable),
        placement=message,
        warnings=warnings,
    )


def _place_of_colors(mesh: Mesh) -> Literal["none", "corners", "textures"]:
    if mesh.colors is None:
        return "none"
    return "textures" if mesh.colors.textures else "corners"


def check_mesh(mesh: Mesh, *, own: Mesh | None = None, half_extent: float = HALF_EXTENT) -> None:
    """Refuse a mesh that cannot be filled with particles.

    Args:
        mesh: Mesh in grid units.
        own: The same one in its own coordinates, which tell where it is open.
        half_extent: Half edge of the usable cube [grid units].

    Raises:
        MeshError: The mesh is larger than the domain, has room for fewer than 500 particles even
            at 4 per cell edge, or more than 5 % of the points around it have an ambiguous winding
            number.
    """
    problem = _problem(mesh, ambiguous_winding(mesh), half_extent, own or mesh)
    if problem:
        raise problem


def ambiguous_winding(mesh: Mesh) -> float:
    """Share of points whose winding number is no integer, among those that feel the mesh.

    Measured on a lattice of about 20 000 points over the bounding box: the points with
    |w - round(w)| > 1/4, divided by those with |w| > 1/4. It is 0 for closed surfaces, however
    they overlap, and grows with the size of the openings. A point on a face is half inside, so the
    lattice keeps off faces at simple fractions of the box.
    """
    lower, upper = mesh.bounds
    extent = upper - lower
    even = float(np.cbrt(extent.prod() / PROBE_COUNT))
    spacing = max(even, float(extent.max()) / PROBES_PER_AXIS)
    shape = np.maximum(np.ceil(extent / spacing), 1).astype(int)
    fractions = (np.indices(shape).reshape(3, -1).T + PROBE_PHASE) / shape
    winding = winding_number(mesh, lower + extent * fractions)
    ambiguous = np.abs(winding - np.rint(winding)) > AMBIGUOUS_DISTANCE
    felt = np.abs(winding) > AMBIGUOUS_DISTANCE
    return int(ambiguous.sum()) / max(int(felt.sum()), 1)


def _problem(mesh: Mesh, ambiguous: float, half_extent: float, own: Mesh) -> MeshError | None:
    """Why a mesh cannot be used, if so."""
    if not _fits(mesh, half_extent):
        lower, upper = mesh.bounds
        return MeshError(
            f"{mesh.name} extends from {_text(lower)} to {_text(upper)}, beyond the "
            f"domain, which ends at {half_extent:g} grid units from its centre.",
            size_remedy(mesh.name),
        )
    if mesh.volume < LEAST_VOLUME:
        return MeshError(
            f"{mesh.name} has a volume of only {mesh.volume:.2g} cubic grid units, room for fewer "
            f"than {MINIMUM_PARTICLES} particles.",
            _room_remedy(mesh, half_extent),
        )
    if ambiguous > AMBIGUOUS_LIMIT:
        return MeshError(
            f"{ambiguous:.0%} of the points around {mesh.name} are neither inside nor outside: "
            f"{_diagnosis(own)}.",
            "Close the surface and make its normals consistent in a mesh editor, for "
            "instance with Fill Holes and Recalculate Outside in Blender.",
        )
    return None


def _room_remedy(mesh: Mesh, half_extent: float) -> str:
    """How a mesh gets room for particles.

    A fit keeps meshes in the domain, where those that are long and thin may still be too small.
    """
    volume, reach = mesh.volume, float(np.abs(mesh.bounds).max())
    if volume <= 0 or mesh.name.startswith(TEXT_PREFIX):
        return f"Thicken thin parts. {size_remedy(mesh.name)}"
    fit = fit_alone(Solid.of(mesh), "volume", reach_in(half_extent))
    if volume * fit.scale**3 >= LEAST_VOLUME:
        helps = size_remedy(mesh.name) if fit.scale > LARGEST_FACTOR else VOLUME_REMEDY
        return f"Thicken thin parts. {helps}"
    factor = math.ceil(10 * float(np.cbrt(LEAST_VOLUME / volume)) * SLACK) / 10
    extent = math.ceil(factor * reach)
    if extent > MOST_CELLS / 2:
        return "Thicken thin parts."
    wider = f"`grid.half_extent` to {extent} and " if extent > half_extent else ""
    return (
        f"Thicken thin parts; or make `placement.source.scale` or `placement.target.scale`, "
        f"whichever is its own, {factor:g} times as large, and set {wider}"
        f"`sampling.points_per_cell_edge` to {POINTS_PER_CELL_EDGE[-1]}."
    )


def _fits(mesh: Mesh, half_extent: float) -> bool:
    return bool(np.abs(mesh.bounds).max() <= half_extent)


def _resolution(mesh: Mesh, points_per_cell_edge: int) -> Resolution:
    count = len(sample_lattice(mesh, spacing=1 / points_per_cell_edge, minimum_count=0))
    target_count = round(REFERENCE_VOLUME * points_per_cell_edge**3)
    config = configure(overrides={"sampling.points_per_cell_edge": points_per_cell_edge})
    nodes = config.method.node_count(
        config, radius=outer_radius(mesh.vertices), ratio=target_count / max(count, 1)
    )
    return Resolution(
        points_per_cell_edge=points_per_cell_edge,
        particle_count=count,
        estimate=estimate(count, target_count, FRAMES, nodes=nodes),
    )


def _diagnosis(mesh: Mesh) -> str:
    """Say which part of a mesh is open."""
    openings = Topology(mesh.vertices, mesh.faces).openings
    if not openings:
        return "its faces intersect or are duplicated"
    largest = openings[0]
    return (
        f"the largest of {len(openings)} openings or seams of reversed faces has "
        f"{largest.edge_count} edges, centre {_text(largest.centre)} and size "
        f"{_text(largest.size)}"
    )


def _text(vector: object) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in np.asarray(vector, np.float64)) + ")"
