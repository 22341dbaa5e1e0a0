"""The choices in which the runs of the planar experiment differ, as data.

The paper prints sizes, steps, learning rates and weights (its appendix on the 2D experiment), but
neither optimizer nor normalization, nor how star and circle are sampled, nor whether clipping
precedes repulsion. The defaults are those of algorithm 10; what all runs share stands beside the
code that uses it.
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


class PlanarConfig(BaseModel, frozen=True, extra="forbid"):
    """One run of circle -> star. Lengths are the paper's: the star's outer radius is 1."""

    strategy: Strategy = Field("per_point", description="What the variables are, and repulsion.")

    point_count: Count = Field(600, description="N, points on the circle.")
    target_count: Count = Field(200, description="M, points on the star.")

    optimizer: Literal["gradient_descent", "adam"] = "gradient_descent"
    learning_rate: Positive = 0.015
    steps: Count = 300
    decay: Literal["none", "cosine"] = Field(
        "none", description="The learning rate stays, or falls to 0 along half a cosine."
    )
    clip_percentile: float | None = Field(
        95.0, gt=0, le=100, description="Longer gradients are cut to this percentile; none: never."
    )
    clip_order: Literal["after_repulsion", "before_repulsion"] = "after_repulsion"

    repulsion_weight: float = Field(2e-4, ge=0)
    repulsion_power: Positive = Field(2.0, description="The force is 1 / d^power.")
    repulsion_average: Literal["neighbors", "none"] = Field(
        "neighbors", description="Mean or sum of the forces of the neighbours."
    )
    repulsion_reaction: bool = Field(
        False, description="Neighbours feel the opposite force, as from a penalty's gradient."
    )


def paper_setting(strategy: Strategy, *, clip: bool = True) -> PlanarConfig:
    """The run as the paper describes it: 300 plain steps of a mean-normalised squared loss.

    The paper says that gradients are clipped in all three strategies, at their 95th percentile; its
    Fourier number is met without.
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
    the force between them is steep. Repulsion is the gradient of a penalty here, with a reaction on
    the neighbours: without one there is no function in whose minimum the run could come to rest.
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
