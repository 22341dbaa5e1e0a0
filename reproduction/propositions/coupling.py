"""Corollary 1: what a local penalty cannot do to a cluster's drift, a shared field does.

Two couplings stand for "beyond the neighbourhood". Both are linear maps from the descent direction
of each point to the velocity of all, and leave a common translation as it is, so that their rates
can be compared with that of independent points:

- a basis: displacements are combinations of the six polynomials of degree 2 that all points share;
- a grid: velocities are averaged on the nodes of a grid and interpolated back, as in MPM. How far
  it reaches depends on its cells, so that it is measured with many sizes and places of them.

As written the corollary is refuted: a local repulsion suppresses collapse while the Chamfer
distance falls.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.config import Strategy, converged_setting
from chamfer_morph.reproduction.planar.experiment import optimize
from chamfer_morph.reproduction.planar.metrics import PlanarMetrics, measure
from chamfer_morph.reproduction.planar.shapes import circle, star
from chamfer_morph.reproduction.propositions.check import Check, Limit, Quantity
from chamfer_morph.reproduction.propositions.collapse import RATE, Coupling, descend
from chamfer_morph.reproduction.propositions.drift import drift, penalty_force
from chamfer_morph.reproduction.propositions.scene import (
    cluster,
    elsewhere,
    forward_gradient,
    spread,
)

Points = npt.NDArray[np.float64]
STEPS = 100
CELLS = (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0)
"""Node spacings of grids. The cluster's diameter is .4, and its nearest other point .67 away."""

SHIFTS = (0.0, 0.25, 0.5)
"""Where the first node right of q* lies, in cells: a result must not hang on it."""

WIDE = 0.75
"""From this spacing on a cell holds points of the cluster and others."""

NARROW = 0.3
"""Up to this spacing no node is shared by the cluster and other points."""


REACH = 1.5
"""No point of the scene is farther than this from q* along an axis."""


def corollary_1() -> Check:
    """Measure drift, far influence and collapse with and without coupling."""
    members = cluster()
    free = _spread_left(independent)
    wide = [grid(cell, shift) for cell in CELLS if cell >= WIDE for shift in SHIFTS]
    narrow = [grid(cell, shift) for cell in CELLS if cell <= NARROW for shift in SHIFTS]
    bare, shared = _planar_end("per_point"), _planar_end("fourier")
    local = _planar_end("repulsion", repulsion_weight=1e-6)
    start = measure(circle(200), star(100))
    return Check(
        name="Corollary 1",
        statement=(
            "A coupling that reaches no further than a cluster's neighbourhood leaves its drift to "
            "the Chamfer term alone; to suppress collapse takes one that reaches further."
        ),
        quantities=(
            *(
                Quantity(
                    f"drift ratio with a local penalty ({name})",
                    drift(members, penalty_force(name, members, 1.0)),
                    1.0,
                    tolerance=1e-9,
                )
                for name in ("repulsion", "smoothness")
            ),
            Quantity("drift ratio with a shared basis", coupled_drift(basis), 0.9, "<="),
            Quantity(
                f"drift ratio with a grid, largest over cells of {WIDE} to {CELLS[-1]:g}",
                max(map(coupled_drift, wide)),
                0.9,
                "<=",
            ),
            Quantity(
                "change of the cluster's velocity when far points are turned by 90 degrees, "
                "as a share of it, independent points",
                _far_influence(independent),
                0.0,
            ),
            Quantity("the same with a shared basis", _far_influence(basis), 0.1, ">="),
            Quantity(
                "the same with a grid, least over these cells",
                min(map(_far_influence, wide)),
                0.1,
                ">=",
            ),
            Quantity(
                f"spread of the cluster after {STEPS} steps, as a share, independent points",
                free,
                (1 - RATE) ** STEPS,
                tolerance=1e-9,
            ),
            Quantity("the same with a shared basis", _spread_left(basis), 10 * free, ">="),
            Quantity(
                "the same with a grid, least over these cells",
                min(map(_spread_left, wide)),
                10 * free,
                ">=",
            ),
        ),
        refuted_by=(
            Limit(
                "Local repulsion suppresses collapse: circle to star with 200 points and 100 "
                "targets, at rest, weight 1e-6. The centroid's drift is not collapse: a cluster "
                "can come to rest with its centroid on target and its points apart.",
                Quantity(
                    "points within .02 of another, with repulsion over without",
                    local.cluster_02 / bare.cluster_02,
                    1.0,
                    tolerance=0.1,
                ),
            ),
            Limit(
                "It does so while the Chamfer objective falls.",
                Quantity(
                    "Chamfer distance at rest, with repulsion, over that at the start",
                    local.cd / start.cd,
                    1.0,
                    ">=",
                ),
            ),
        ),
        limits=(
            Limit(
                "A grid whose cells do not span the gap between the cluster and other points is a "
                "local coupling: it leaves the drift alone.",
                Quantity(
                    f"drift ratio with a grid, least over cells of {CELLS[0]} to {NARROW}",
                    min(map(coupled_drift, narrow)),
                    0.9,
                    "<=",
                ),
            ),
            Limit(
                "Nor does locality cost distance: at rest the locally regularised points are "
                "nearer to the star than those with a shared basis.",
                Quantity(
                    "Chamfer distance with local repulsion over that with 25 shared coefficients",
                    local.cd / shared.cd,
                    1.0,
                    ">=",
                ),
            ),
        ),
    )


def independent(points: Points, direction: Points) -> Points:
    """No coupling: each point follows its own direction."""
    return direction


def basis(points: Points, direction: Points) -> Points:
    """Least-squares fit of the directions by quadratic polynomials of the position."""
    x, y = points.T
    shared = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    columns = np.linalg.qr(shared)[0]
    velocity: Points = columns @ (columns.T @ direction)
    return velocity


def grid(cell: float, shift: float = 0.5) -> Coupling:
    """Bilinear averages on grid nodes, interpolated back to the points.

    Args:
        cell: Node spacing.
        shift: Place of the first node right of q*, in cells, 0 to 1.
    """

    def coupling(points: Points, direction: Points) -> Points:
        weight = _node_weights(points, cell, shift)
        mass = weight.sum(axis=0)[:, None]
        nodes = np.divide(weight.T @ direction, mass, where=mass > 0, out=np.zeros((len(mass), 2)))
        velocity: Points = weight @ nodes
        return velocity

    return coupling


def coupled_drift(coupling: Coupling) -> float:
    """Drift of the cluster under a coupling, as a multiple of 2 eta / N (centroid - q*)."""
    points, members = _scene()
    direction = -forward_gradient(points)
    return drift(points, coupling(points, direction) - direction, members=members)


def coupled_descent(coupling: Coupling) -> Points:
    """Positions of the cluster before and after each step, shape [`STEPS` + 1, members, 2].

    Couplings follow the points as these move.
    """
    points, members = _scene()
    return descend(points, STEPS, coupling=coupling)[:, :members]


def _scene() -> tuple[Points, int]:
    members = cluster()
    return np.vstack([members, elsewhere()]), len(members)


def _node_weights(points: Points, cell: float, shift: float) -> Points:
    """Bilinear weights of all nodes of a grid about q*, shape [n, nodes]."""
    reach = int(np.ceil(REACH / cell)) + 1
    line = cell * (np.arange(-reach, reach + 1) + shift)
    hat = [np.maximum(0, 1 - abs(points[:, axis, None] - line) / cell) for axis in (0, 1)]
    weight: Points = np.einsum("ni,nj->nij", *hat).reshape(len(points), -1)
    return weight


def _far_influence(coupling: Coupling) -> float:
    """How much the cluster's mean velocity depends on what points outside it want."""
    points, members = _scene()
    direction = -forward_gradient(points)
    turned = direction.copy()
    turned[members:] = direction[members:] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    before, after = (coupling(points, each)[:members].mean(axis=0) for each in (direction, turned))
    return float(np.linalg.norm(after - before) / np.linalg.norm(before))


def _spread_left(coupling: Coupling) -> float:
    way = coupled_descent(coupling)
    return spread(way[-1]) / spread(way[0])


def _planar_end(strategy: Strategy, repulsion_weight: float = 0.0) -> PlanarMetrics:
    """Circle to star at rest."""
    config = converged_setting(strategy, steps=1500, repulsion_weight=repulsion_weight)
    small = config.model_copy(update={"point_count": 200, "target_count": 100})
    return measure(optimize(small)[-1], star(small.target_count))
