"""Corollary 1: what a local penalty cannot do to a cluster's drift, a shared field does.

Two couplings stand for "beyond the neighbourhood". Both are linear maps from the descent direction
of each point to the velocity of all, and leave a common translation as it is, so that their rates
can be compared with that of independent points:

- a basis: displacements are combinations of the six polynomials of degree 2 that all points share;
- a grid: velocities are averaged on the nodes of a grid and interpolated back, as in MPM.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.config import Strategy, converged_setting
from chamfer_morph.reproduction.planar.experiment import optimize
from chamfer_morph.reproduction.planar.metrics import PlanarMetrics, measure
from chamfer_morph.reproduction.planar.shapes import star
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
CELL = 0.75
"""Node spacing of the grid; the cluster's diameter is .4."""


def corollary_1() -> Check:
    """Measure drift, far influence and collapse with and without coupling."""
    members = cluster()
    free = _spread_left(independent)
    bare, shared = _planar_end("per_point"), _planar_end("fourier")
    local = _planar_end("repulsion", repulsion_weight=1e-6)
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
            Quantity("drift ratio with a grid", coupled_drift(grid), 0.9, "<="),
            Quantity(
                "change of the cluster's velocity when far points are turned by 90 degrees, "
                "as a share of it, independent points",
                _far_influence(independent),
                0.0,
            ),
            Quantity("the same with a shared basis", _far_influence(basis), 0.1, ">="),
            Quantity("the same with a grid", _far_influence(grid), 0.1, ">="),
            Quantity(
                f"spread of the cluster after {STEPS} steps, as a share, independent points",
                free,
                (1 - RATE) ** STEPS,
                tolerance=1e-9,
            ),
            Quantity("the same with a shared basis", _spread_left(basis), 10 * free, ">="),
            Quantity("the same with a grid", _spread_left(grid), 10 * free, ">="),
        ),
        limits=(
            Limit(
                "The centroid's drift is not collapse. A cluster can come to rest with its "
                "centroid on target and its points apart: circle to star with 200 points and 100 "
                "targets, at rest, local repulsion of weight 1e-6.",
                Quantity(
                    "points within .02 of another, with repulsion over without",
                    local.cluster_02 / bare.cluster_02,
                    1.0,
                    tolerance=0.1,
                ),
            ),
            Limit(
                "Nor does that cost what the corollary expects: at rest the locally regularised "
                "points are nearer to the star than those with a shared basis.",
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


def grid(points: Points, direction: Points) -> Points:
    """Bilinear averages on grid nodes, interpolated back to the points."""
    weight = _node_weights(points)
    mass = weight.sum(axis=0)
    nodes = np.divide(
        weight.T @ direction, mass[:, None], where=mass[:, None] > 0, out=np.zeros((len(mass), 2))
    )
    velocity: Points = weight @ nodes
    return velocity


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


def _node_weights(points: Points) -> Points:
    """Bilinear weights of all nodes of a grid about q*, shape [n, nodes]."""
    line = CELL * (np.arange(-4, 5) + 0.5)
    hat = [np.maximum(0, 1 - abs(points[:, axis, None] - line) / CELL) for axis in (0, 1)]
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
