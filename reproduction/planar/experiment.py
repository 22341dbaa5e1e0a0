"""Run the planar experiment: one configuration, or all rows of its table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.chamfer import chamfer_loss
from chamfer_morph.reproduction.planar.config import (
    TUNED_REPULSION,
    VECTOR_REPULSION,
    PlanarConfig,
    converged_setting,
    paper_setting,
)
from chamfer_morph.reproduction.planar.fourier import FourierOutline
from chamfer_morph.reproduction.planar.metrics import PlanarMetrics, measure
from chamfer_morph.reproduction.planar.optimizer import Optimizer, clip
from chamfer_morph.reproduction.planar.repulsion import repulsion
from chamfer_morph.reproduction.planar.shapes import CIRCLE_RADIUS, circle, circle_angles, star

Points = npt.NDArray[np.float64]
Setting = Literal["reference", "paper", "converged"]

NEIGHBORS = 6
"""How many others repel a point."""


@dataclass(frozen=True)
class Printed:
    """A row of the paper's table of the 2D experiment; shares run from 0 to 1."""

    cd: float
    coverage: float
    cluster_02: float


PRINTED = {
    "dco": Printed(0.352, 0.38, 0.97),
    "dco_repulsion": Printed(0.299, 0.50, 0.97),
    "fourier": Printed(0.123, 0.62, 0.81),
}


@dataclass(frozen=True)
class PlanarRow:
    """A row of the table.

    Attributes:
        name: `dco`, `dco_repulsion`, `fourier`; a suffix says what is different: `_clipped`
            gradients, a repulsion in the `_vector` form, a `_tuned` repulsion weight. References
            are `start` and `even_spread`.
        setting: "reference", "paper" or "converged".
        config: What was run; None for a reference.
        trajectory: Positions from the first to the last, shape [s, n, 2], float64.
        metrics: Numbers of the last positions.
    """

    name: str
    setting: Setting
    config: PlanarConfig | None
    trajectory: Points
    metrics: PlanarMetrics

    @property
    def steps(self) -> int:
        """Optimizer steps."""
        return self.config.steps if self.config else 0

    @property
    def printed(self) -> Printed | None:
        """What the paper prints for this strategy, if this is the paper's setting."""
        strategy = self.name.removesuffix("_clipped").removesuffix("_vector")
        return PRINTED[strategy] if self.setting == "paper" else None


Place = tuple[str, Setting]
PlanarTable = dict[Place, PlanarRow]
"""Rows by name and setting, in order."""


def optimize(config: PlanarConfig, *, snapshots: int = 31) -> Points:
    """Optimise the points of one configuration.

    Args:
        config: What to run.
        snapshots: How many states to keep, evenly over the steps, first and last included.

    Returns:
        Positions at these, shape [snapshots, n, 2], float64.
    """
    target = star(config.target_count)
    variables, points_of, pull_back = _parameterisation(config)
    kept = np.linspace(0, config.steps, snapshots).round()
    trajectory = [points_of(variables)]
    optimizer = Optimizer(config)
    for step in range(1, config.steps + 1):
        gradient = _gradient(config, points_of(variables), target)
        variables = variables - optimizer(pull_back(gradient))
        if step in kept:
            trajectory.append(points_of(variables))
    return np.stack(trajectory)


def configurations(*, converged_steps: int = 5000) -> dict[Place, PlanarConfig]:
    """What is run by name and setting: the paper's, and the same losses brought to rest.

    Args:
        converged_steps: Budget of the converged rows; only tests want fewer than 5000.
    """
    tuned = converged_setting("repulsion", steps=converged_steps, repulsion_weight=TUNED_REPULSION)
    return {
        ("dco", "paper"): paper_setting("per_point"),
        ("dco_repulsion", "paper"): paper_setting("repulsion"),
        ("dco_repulsion_vector", "paper"): VECTOR_REPULSION,
        ("fourier", "paper"): paper_setting("fourier", clip=False),
        ("fourier_clipped", "paper"): paper_setting("fourier"),
        ("dco", "converged"): converged_setting("per_point", steps=converged_steps),
        ("dco_repulsion", "converged"): converged_setting("repulsion", steps=converged_steps),
        ("dco_repulsion_tuned", "converged"): tuned,
        ("fourier", "converged"): converged_setting("fourier", steps=converged_steps),
    }


def run_all(*, converged_steps: int = 5000) -> PlanarTable:
    """The table: two references, and all that is run; half a minute with 5000 converged steps.

    The references are the circle before the first step and an ideal result: as many points spread
    evenly over the star. No strategy can be judged by a number that the ideal does not win.
    """
    default = PlanarConfig()
    target = star(default.target_count)
    ways: dict[Place, tuple[PlanarConfig | None, Points]] = {
        ("start", "reference"): (None, circle(default.point_count)[None]),
        ("even_spread", "reference"): (None, star(default.point_count)[None]),
    }
    for place, config in configurations(converged_steps=converged_steps).items():
        ways[place] = config, optimize(config)
    return {
        place: PlanarRow(*place, config, way, measure(way[-1], target))
        for place, (config, way) in ways.items()
    }


def _parameterisation(
    config: PlanarConfig,
) -> tuple[Points, Callable[[Points], Points], Callable[[Points], Points]]:
    """First variables, the points they stand for, and the gradient by them from that by points."""
    if config.strategy == "fourier":
        outline = FourierOutline(circle_angles(config.point_count))
        return outline.circle(CIRCLE_RADIUS), outline.points, outline.pull_back
    return circle(config.point_count), lambda points: points, lambda gradient: gradient


def _gradient(config: PlanarConfig, points: Points, target: Points) -> Points:
    """Gradient by the points, repulsion and clipping included."""
    gradient = chamfer_loss(points, target)[1]
    if config.clip_order == "before_repulsion":
        gradient = _clipped(config, gradient)
    if config.strategy == "repulsion":
        gradient = gradient - config.repulsion_weight * repulsion(
            points,
            neighbors=NEIGHBORS,
            power=config.repulsion_power,
            average=config.repulsion_average == "neighbors",
            reaction=config.repulsion_reaction,
        )
    return _clipped(config, gradient) if config.clip_order == "after_repulsion" else gradient


def _clipped(config: PlanarConfig, gradient: Points) -> Points:
    return gradient if config.clip_percentile is None else clip(gradient, config.clip_percentile)
