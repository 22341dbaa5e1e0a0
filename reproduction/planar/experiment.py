"""Run the planar experiment: one configuration, or all rows of its table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.chamfer import ChamferLoss
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
from chamfer_morph.reproduction.planar.shapes import circle, circle_angles, even_star, star

Points = npt.NDArray[np.float64]
Setting = Literal["reference", "paper", "converged"]


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
class Experiment:
    """A row to be run.

    Attributes:
        name: `dco`, `dco_repulsion`, `fourier`; a suffix says what is different: `_clipped`
            gradients, a repulsion in the `_vector` form, a `_tuned` repulsion weight.
        setting: "paper" or "converged".
        config: The run.
    """

    name: str
    setting: Setting
    config: PlanarConfig


@dataclass(frozen=True, kw_only=True)
class PlanarRow(PlanarMetrics):
    """A row of the table as plain data: its numbers, and what they are of.

    Attributes:
        name: Of the experiment; references are "start" and "even_spread".
        setting: "reference", "paper" or "converged".
        steps: Optimizer steps.
        printed: What the paper prints for this strategy, if this is the paper's setting.
    """

    name: str
    setting: Setting
    steps: int
    printed: Printed | None


@dataclass(frozen=True)
class PlanarRun:
    """What a run leaves behind.

    Attributes:
        experiment: What was run.
        steps: Steps after which a snapshot was taken, ascending from 0 to the last, shape [s].
        trajectory: Positions at these, shape [s, n, 2], float64.
        metrics: Numbers of the last positions.
    """

    experiment: Experiment
    steps: npt.NDArray[np.int64]
    trajectory: Points
    metrics: PlanarMetrics


def run(experiment: Experiment, *, snapshots: int = 31) -> PlanarRun:
    """Optimise the points of one configuration.

    Args:
        experiment: What to run.
        snapshots: How many states to keep, evenly over the steps, first and last included.
    """
    config = experiment.config
    target = star(config)
    variables, points_of, pull_back = _parameterisation(config)
    kept = np.unique(np.linspace(0, config.steps, snapshots).round().astype(np.int64))
    trajectory = [points_of(variables)]
    optimizer = Optimizer(config)
    for step in range(1, config.steps + 1):
        gradient = _gradient(config, points_of(variables), target)
        variables = variables - optimizer(pull_back(gradient))
        if step in kept:
            trajectory.append(points_of(variables))
    return PlanarRun(experiment, kept, np.stack(trajectory), measure(trajectory[-1], target))


def experiments(*, converged_steps: int = 5000) -> tuple[Experiment, ...]:
    """All rows of the table: the paper's setting, and the same losses brought to rest.

    Args:
        converged_steps: Budget of the converged rows; only tests want fewer than 5000.
    """
    tuned = converged_setting("repulsion", steps=converged_steps, repulsion_weight=TUNED_REPULSION)
    return (
        Experiment("dco", "paper", paper_setting("per_point")),
        Experiment("dco_repulsion", "paper", paper_setting("repulsion")),
        Experiment("dco_repulsion_vector", "paper", VECTOR_REPULSION),
        Experiment("fourier", "paper", paper_setting("fourier", clip=False)),
        Experiment("fourier_clipped", "paper", paper_setting("fourier")),
        Experiment("dco", "converged", converged_setting("per_point", steps=converged_steps)),
        Experiment(
            "dco_repulsion", "converged", converged_setting("repulsion", steps=converged_steps)
        ),
        Experiment("dco_repulsion_tuned", "converged", tuned),
        Experiment("fourier", "converged", converged_setting("fourier", steps=converged_steps)),
    )


def run_all(*, converged_steps: int = 5000) -> tuple[PlanarRun, ...]:
    """Run every row of `experiments`; about a minute with 5000 converged steps."""
    return tuple(run(each) for each in experiments(converged_steps=converged_steps))


def rows(runs: tuple[PlanarRun, ...]) -> tuple[PlanarRow, ...]:
    """The table: two references, then one row per run.

    The references are the circle before the first step and an ideal result: as many points spread
    evenly over the star. No strategy can be judged by a number that the ideal does not win.

    Args:
        runs: From `run_all`.
    """
    config = PlanarConfig()
    target = star(config)
    ideal = even_star(config, config.point_count)
    return (
        _row("start", "reference", measure(circle(config), target), 0),
        _row("even_spread", "reference", measure(ideal, target), 0),
        *(
            _row(each.experiment.name, each.experiment.setting, each.metrics, int(each.steps[-1]))
            for each in runs
        ),
    )


def _row(name: str, setting: Setting, numbers: PlanarMetrics, steps: int) -> PlanarRow:
    strategy = name.removesuffix("_clipped").removesuffix("_vector")
    printed = PRINTED[strategy] if setting == "paper" else None
    return PlanarRow(**vars(numbers), name=name, setting=setting, steps=steps, printed=printed)


def _parameterisation(
    config: PlanarConfig,
) -> tuple[Points, Callable[[Points], Points], Callable[[Points], Points]]:
    """First variables, the points they stand for, and the gradient by them from that by points."""
    if config.strategy == "fourier":
        outline = FourierOutline(circle_angles(config), config.fourier_modes)
        return outline.circle(config.circle_radius), outline.points, outline.pull_back
    return circle(config), lambda points: points, lambda gradient: gradient


def _gradient(config: PlanarConfig, points: Points, target: Points) -> Points:
    """Gradient by the points, repulsion and clipping included."""
    loss = ChamferLoss(
        config.forward_weight,
        config.reverse_weight,
        squared=config.distance == "squared",
        normalization=config.normalization,
    )
    gradient = loss(points, target)[1]
    if config.clip_order == "before_repulsion":
        gradient = _clipped(config, gradient)
    if config.strategy == "repulsion":
        gradient = gradient - config.repulsion_weight * repulsion(
            points,
            neighbors=config.repulsion_neighbors,
            power=config.repulsion_power,
            average=config.repulsion_average == "neighbors",
            floor=config.repulsion_floor,
            reaction=config.repulsion_reaction,
        )
    return _clipped(config, gradient) if config.clip_order == "after_repulsion" else gradient


def _clipped(config: PlanarConfig, gradient: Points) -> Points:
    if config.clip_percentile is None:
        return gradient
    return clip(gradient, config.clip_percentile, config.clip_unit)
