"""Every choice of the planar experiment as data, those that the paper leaves open included.

The paper prints sizes, steps, learning rates and weights (its appendix on the 2D experiment), but
neither optimizer nor normalization, nor how star and circle are sampled, nor whether clipping
precedes repulsion. Each of these is a field here; the defaults are those of algorithm 10.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]

Strategy = Literal["per_point", "repulsion", "fourier"]

TUNED_REPULSION = 1e-7
"""A repulsion weight that fits the mean-normalised loss; the paper's 2e-4 is far above it. Of 1e-9,
1e-8 .. 1e-6 it is the one whose result is the same after 2500, 5000 and 10000 steps and free of
heaps."""


class PlanarConfig(BaseModel, frozen=True, extra="forbid", validate_default=True):
    """One run of circle -> star. Lengths are the paper's: the star's outer radius is 1."""

    strategy: Strategy = Field("per_point", description="What the variables are, and repulsion.")

    point_count: Count = Field(600, description="N, points on the circle.")
    circle_radius: Positive = 0.8
    circle_angles: Literal["regular", "random"] = Field(
        "regular", description="Angles 2 pi i / N, or independent and uniform."
    )
    target_count: Count = Field(200, description="M, points on the star.")
    star_arms: int = Field(5, ge=2)
    star_inner_radius: Positive = 0.25
    star_outer_radius: Positive = 1.0
    star_orientation: float = Field(90.0, description="Direction of the first tip [degrees].")
    star_sampling: Literal["corners", "between", "random"] = Field(
        "corners",
        description="Even by arc length from a corner on, from half a spacing on, or random.",
    )
    seed: int = Field(0, description="Of whatever is random.")

    forward_weight: float = Field(1.0, ge=0)
    reverse_weight: float = Field(1.0, ge=0)
    distance: Literal["squared", "plain"] = "squared"
    normalization: Literal["mean", "sum"] = Field("mean", description="Over points, each way.")

    optimizer: Literal["gradient_descent", "adam"] = "gradient_descent"
    learning_rate: Positive = 0.015
    steps: Count = 300
    decay: Literal["none", "cosine"] = Field(
        "none", description="The learning rate stays, or falls to 0 along half a cosine."
    )
    beta1: float = Field(0.9, ge=0, lt=1)
    beta2: float = Field(0.999, ge=0, lt=1)
    epsilon: Positive = 1e-8
    clip_percentile: float | None = Field(
        95.0, gt=0, le=100, description="Longer gradients are cut to this percentile; none: never."
    )
    clip_unit: Literal["point", "component"] = Field(
        "point", description="What has a length: a point's gradient vector, or each number of it."
    )
    clip_order: Literal["after_repulsion", "before_repulsion"] = "after_repulsion"

    repulsion_weight: float = Field(2e-4, ge=0)
    repulsion_neighbors: Count = 6
    repulsion_power: Positive = Field(2.0, description="The force is 1 / d^power.")
    repulsion_average: Literal["neighbors", "none"] = Field(
        "neighbors", description="Mean or sum of the forces of the neighbours."
    )
    repulsion_floor: Positive = Field(1e-8, description="Distances count as at least this.")
    repulsion_reaction: bool = Field(
        False, description="Neighbours feel the opposite force, as from a penalty's gradient."
    )

    fourier_modes: Count = Field(12, description="K; 2 K + 1 coefficients.")


def paper_setting(strategy: Strategy, *, clip: bool = True) -> PlanarConfig:
    """The run as the paper describes it: 300 plain steps of a mean-normalised squared loss.

    Args:
        strategy: Which of the three.
        clip: Whether gradients are clipped at the 95th percentile. The paper says so for all three;
            its Fourier number is met without.
    """
    return PlanarConfig(
        strategy=strategy,
        learning_rate=_learning_rate(strategy),
        clip_percentile=95.0 if clip else None,
    )


VECTOR_REPULSION = PlanarConfig(
    strategy="repulsion",
    repulsion_power=1.0,
    repulsion_average="none",
    clip_order="before_repulsion",
)
"""Repulsion in the form of the paper's remark on proposition 3 with alpha = 0: the force of a
neighbour is (p_i - p_j) / d^2, of length 1 / d, summed over the neighbours and added to the clipped
gradient. This comes nearer to the paper's row than a force of length 1 / d^2."""


def converged_setting(
    strategy: Strategy, *, steps: int = 5000, repulsion_weight: float = 2e-4
) -> PlanarConfig:
    """The same loss brought to rest: Adam without clipping, from the paper's learning rates.

    The rate falls to 0. At a constant one Adam keeps throwing points about: where two are close,
    the force between them is steep.

    Args:
        strategy: Which of the three.
        steps: How many steps.
        repulsion_weight: Weight of the repulsive force; only `repulsion` looks at it. Here
            repulsion is the gradient of a penalty, with a reaction on the neighbours: without one
            there is no function in whose minimum the run could come to rest.
    """
    return PlanarConfig(
        strategy=strategy,
        learning_rate=_learning_rate(strategy),
        steps=steps,
        optimizer="adam",
        decay="cosine",
        clip_percentile=None,
        repulsion_weight=repulsion_weight,
        repulsion_reaction=True,
    )


def _learning_rate(strategy: Strategy) -> float:
    return 0.003 if strategy == "fourier" else 0.015
