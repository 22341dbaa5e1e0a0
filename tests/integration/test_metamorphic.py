"""What a morph must not depend on: where its meshes lie, how large they are, how they are numbered.

Meshes are fitted to the domain in float64, and what differs in its last digits is gone once the
particles are float32. So input that is moved, in other units or numbered otherwise gives the same
particles to the bit, and then the same morph to the bit. A turned lattice has its particles in
another order, sums on the grid are taken in that order, and differences of rounding grow: there
is a tolerance for each method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morph_engine.geometry.mesh import Mesh, make_mesh
from morph_engine.morphing import Frame, morph, prepare
from morph_engine.presets import configure

COARSE = {
    "sampling.points_per_cell_edge": 1,
    "sampling.lattice": "even",
    "sampling.fit": "volume",
}
Change = Callable[[Mesh], Mesh]


def bar() -> Mesh:
    """A box that is wider at one end and higher at the other."""
    box = trimesh.creation.box((16, 9, 10)).subdivide()
    x, y, z = box.vertices.T
    points = np.stack([x, y * (1 + x / 32), z * (1 - x / 40)], axis=1)
    return make_mesh(points, box.faces, name="bar")


def egg() -> Mesh:
    """A bent ellipsoid."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=6.7)
    x, y, z = ball.vertices.T * [[0.8], [1.25], [1.0]]
    return make_mesh(np.stack([x, y, z + 0.02 * y**2], axis=1), ball.faces, name="egg")


def unchanged(mesh: Mesh) -> Mesh:
    """The mesh."""
    return mesh


def turned(mesh: Mesh) -> Mesh:
    """The mesh after a quarter turn about z."""
    x, y, z = mesh.vertices.T
    return make_mesh(np.stack([-y, x, z], axis=1), mesh.faces, name=mesh.name)


def turned_back(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Positions before the quarter turn."""
    x, y, z = positions.T
    return np.stack([y, -x, z], axis=1)


def moved_in_other_units(mesh: Mesh) -> Mesh:
    """The mesh far off, and a thousand times as large."""
    points = 1000 * (mesh.vertices + np.float64([300, -70, 41.5]))
    return make_mesh(points, mesh.faces, name=mesh.name)


def renumbered(mesh: Mesh) -> Mesh:
    """The mesh with its vertices and its faces in another order, begun at other corners."""
    chance = np.random.default_rng(1)
    order = chance.permutation(len(mesh.vertices))
    faces = np.argsort(order)[mesh.faces][chance.permutation(len(mesh.faces))]
    begins = chance.integers(0, 3, len(faces))
    faces = np.stack([np.roll(face, begin) for face, begin in zip(faces, begins, strict=True)])
    return make_mesh(mesh.vertices[order], faces, name=mesh.name)


@dataclass(frozen=True, eq=False)
class Morphed:
    """A morph from the bar to the egg: where its particles began, and its last frame."""

    began: NDArray[np.float32]
    last: Frame


@cache
def morphed(method: str, change: Change, like_parts: str = "auto") -> Morphed:
    """A short morph between changed meshes."""
    own = {"like_parts": like_parts} if method == "flow" else {}
    config = configure("fast", COARSE | own | {"method": method, "frames": 2})
    source, target = change(bar()), change(egg())
    *_, last = morph(source, target, config)
    return Morphed(prepare(source, target, config).source_points, last)


@pytest.mark.parametrize("change", [moved_in_other_units, renumbered])
@pytest.mark.parametrize("method", ["joint", "flow", "transport"])
def test_place_units_and_numbering_change_no_bit(method: str, change: Change) -> None:
    """The last frame is that of the meshes as they were."""
    usual, other = morphed(method, unchanged), morphed(method, change)
    np.testing.assert_array_equal(other.began, usual.began)
    np.testing.assert_array_equal(other.last.positions, usual.last.positions)


@pytest.mark.parametrize(("method", "tolerance"), [("joint", 1e-4), ("flow", 5e-2)])
def test_a_quarter_turn_turns_the_result(method: str, tolerance: float) -> None:
    """Each particle ends where it did, turned [grid units]: 20 times what rounding makes here.

    Parts are not carried: the bar is as well carried to the egg after half a turn.
    """
    usual, other = morphed(method, unchanged, "off"), morphed(method, turned, "off")
    distances, same = cKDTree(turned_back(other.began)).query(usual.began)
    assert distances.max() < 1e-5 and len({*same}) == len(usual.began)
    ended = turned_back(other.last.positions)[same]
    np.testing.assert_allclose(ended, usual.last.positions, rtol=0, atol=tolerance)


@pytest.mark.parametrize(("method", "tolerance"), [("transport", 1e-4), ("flow", 0.05)])
def test_a_quarter_turn_turns_the_end(method: str, tolerance: float) -> None:
    """In its measures: of pairings that cost the same, the order of the particles chooses one."""
    usual, other = morphed(method, unchanged), morphed(method, turned)
    for name in ("two_sided", "iou"):
        assert other.last.metrics[name] == pytest.approx(usual.last.metrics[name], rel=tolerance)


@pytest.mark.parametrize("method", ["flow", "transport"])
def test_there_and_back_ends_at_the_first_shape(method: str) -> None:
    """Its Hausdorff distance, and that of particles to where they began, are below half of B's.

    The spacing of the lattice is 1, so nothing comes much nearer. `joint` needs tens of frames.
    """
    config = configure("fast", COARSE | {"method": method, "frames": 4})
    first, second = bar(), egg()
    record = prepare(first, [second, first], config)
    frames = [*morph(first, [second, first], config)]
    there = next(frame for frame in reversed(frames) if frame.leg == 0)
    ends = [there.positions, frames[-1].positions]
    away, back = [hausdorff(positions, record.target_points) for positions in ends]
    assert back < away / 2, (back, away)
    began = record.source_points
    away, back = [np.linalg.norm(positions - began, axis=1).mean() for positions in ends]
    assert back < away / 2, (back, away)


def hausdorff(points: NDArray[Any], others: NDArray[Any]) -> float:
    """The largest distance of a point of either set to the other set."""
    return max(cKDTree(others).query(points)[0].max(), cKDTree(points).query(others)[0].max())
