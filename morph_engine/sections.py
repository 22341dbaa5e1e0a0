"""Sections of the configuration: frozen models with units and bounds.

`SharedConfig` holds what every method honours. The other sections belong to several methods, whose
options include those that the method reads.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Vector = tuple[float, float, float]

Kernel = Literal["cubic", "quadratic"]

MOST_CELLS = 250
"""Cells per axis; with more, a node's number would not fit in its integer type."""


class Section(BaseModel, frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False):
    """A part of the configuration, all of whose numbers are finite."""


class GridConfig(Section):
    """Background grid (algorithm 0, 2.1)."""

    dx: Positive = Field(1.0, description="Node spacing, the unit of length of everything else.")
    half_extent: Positive = Field(16.0, description="The domain is [-this, this]^3 [grid units].")
    margin: NonNegative = Field(
        0.0, description="Particles keep this distance from the walls [dx]."
    )

    @model_validator(mode="after")
    def _whole_cells(self) -> GridConfig:
        cells = 2 * self.half_extent / self.dx
        is_whole = math.isfinite(cells) and abs(cells - round(cells)) <= 1e-6
        if not is_whole or not 4 <= round(cells) <= MOST_CELLS:
            raise ValueError(
                f"2 grid.half_extent / grid.dx must be 4 to {MOST_CELLS} whole cells per axis"
            )
        return self

    @model_validator(mode="after")
    def _room_within_margin(self) -> GridConfig:
        if self.margin * self.dx >= self.half_extent:
            raise ValueError(
                f"grid.margin = {self.margin:g} leaves no room for particles in a domain that ends "
                f"{self.half_extent / self.dx:g} dx from its centre"
            )
        return self


class SamplingConfig(Section):
    """Particles from shapes (algorithm 1)."""

    points_per_cell_edge: int = Field(3, ge=1, le=8, description="Lattice points per dx and axis.")
    lattice: Literal["published", "even"] = Field(
        "published",
        description="Jittered, from the corner of the bounding box, or even and without jitter.",
    )
    fit: Literal["auto", "none", "volume", "extent"] = Field(
        "auto",
        description="Scale and centre the meshes: only if they need it (auto), never "
        "(none), each to a common volume, or each to span the domain "
        "(extent).",
    )


class PoseConfig(Section):
    """How a shape is rotated, scaled and moved, in addition to the fit."""

    up: Literal["auto", "y", "z"] = Field(
        "auto", description="Its upward axis; auto: according to its file, if known."
    )
    rotate: Vector = Field(
        (0.0, 0.0, 0.0),
        description="Rotation about x, y and z through its centre, about z first [degrees].",
    )
    scale: Positive = Field(
        1.0, description="Scale factor about its centre, in addition to that of the fit."
    )
    move: Vector = Field((0.0, 0.0, 0.0), description="Shift after the fit [grid units].")


class PlacementConfig(Section):
    """How the two ends of a morph are rotated, scaled and moved."""

    source: PoseConfig = PoseConfig()
    target: PoseConfig = PoseConfig()


class MaterialConfig(Section):
    """Elastic material (algorithm 0, 2.2, 2.8)."""

    model: Literal["neo_hookean", "fixed_corotated"] = "neo_hookean"
    youngs_modulus: Positive = Field(140000.0, description="E [mass / (grid unit s^2)].")
    poisson_ratio: float = Field(0.2, gt=-1, lt=0.5, description="nu.")
    density: Positive = Field(75.0, description="Mass per cubic grid unit.")
    drag: NonNegative = Field(0.5, description="Drag on momentum [1/s].")

    @property
    def lame_lambda(self) -> float:
        """First Lame parameter."""
        nu = self.poisson_ratio
        return self.youngs_modulus * nu / ((1 + nu) * (1 - 2 * nu))

    @property
    def lame_mu(self) -> float:
        """Shear modulus."""
        return self.youngs_modulus / (2 * (1 + self.poisson_ratio))

    @property
    def sound_speed(self) -> float:
        """Speed of elastic pressure waves [grid units / s]."""
        return float(((self.lame_lambda + 2 * self.lame_mu) / self.density) ** 0.5)


class TimeConfig(Section):
    """Time stepping (algorithm 0)."""

    dt: Positive = Field(1 / 120, description="Time step [s].")
    transitions_per_frame: int = Field(9, ge=1, le=100, description="Time steps per frame.")


class SmoothingConfig(Section):
    """Blend s of the new deformation gradient with the old one (algorithm 2.6)."""

    values: tuple[Fraction, ...] = Field((0.88, 0.90, 0.92), description="s, phase by phase.")
    first_frames: tuple[int, ...] = Field((0, 10, 30), description="First frame of each phase.")
    late_value: Fraction = Field(0.7, description="s once the matter has arrived.")
    late_frame: int | None = Field(
        None, ge=0, description="Frame from which `late_value` applies; None: never."
    )

    @model_validator(mode="after")
    def _phases_ascend(self) -> SmoothingConfig:
        starts = self.first_frames
        if len(starts) != len(self.values) or not starts or starts[0] != 0:
            raise ValueError("first_frames must start with 0 and have one entry per value")
        if list(starts) != sorted(set(starts)):
            raise ValueError("first_frames must be strictly ascending")
        return self


class AdjointConfig(Section):
    """Departures of the published program from the exact adjoint (algorithm 4.6)."""

    drop_smoothing: bool = Field(False, description="Omit (1 - s) on the path from F to C.")
    carry_control: bool = Field(False, description="Add s F_bar' to the control gradient.")
    drop_drag: bool = Field(False, description="Omit drag in the derivative of the weights.")


class GridLossConfig(Section):
    """Grid mass loss (algorithm 3)."""

    outside_factor: Positive = Field(5.0, description="Gradient factor where the target is empty.")


class WeightedGridLossConfig(GridLossConfig):
    """Grid mass loss beside another one: its weight over frames (algorithm 7.2, 7.3)."""

    final_weight: Fraction = Field(0.5, description="w_phys after its decay.")
    decay_start: int = Field(15, ge=0, description="Frame at which w_phys begins to fall.")
    decay_frames: Count = Field(5, description="Frames over which w_phys falls.")
    weight_mode: Literal["coupling_only", "chain", "literal"] = Field(
        "coupling_only",
        description="What w_phys applies to: the reverse weight only, also the adjoint of passes "
        "after the first, or the loss as in the paper.",
    )


class ChamferConfig(Section):
    """Bidirectional Chamfer loss (algorithm 5) and its weight over frames (algorithm 7.1)."""

    weight: NonNegative = Field(10.0, description="w_ch after its ramp.")
    start_frame: int = Field(5, ge=0, description="Frame at which the ramp begins.")
    ramp_frames: Count = Field(10, description="Frames over which w_ch rises.")
    normalize: bool = Field(True, description="Scale by L_phys / L_ch each control step.")
    huber_delta: NonNegative = Field(
        1.5, description="The loss is linear beyond this distance; 0: squared everywhere."
    )
    reverse_weight: NonNegative = Field(1.0, description="Weight of the target->source term.")
    reverse_coupled: bool = Field(True, description="Multiply the reverse weight by w_phys.")
    reverse_clamp: NonNegative = Field(3.0, description="kappa: clamp to this mean; 0: off.")
    reverse_smoothing: NonNegative = Field(2.0, description="Gaussian sigma [dx]; 0: off.")
    neighborhood: Literal["exact", "published"] = Field(
        "exact", description="All neighbours, or only those in the 27 cells around a point."
    )


class OptimizerConfig(Section):
    """Optimisation of one frame (algorithm 6)."""

    layers_per_step: Count = Field(
        1, description="Control layers that one step updates together, from one adjoint sweep."
    )
    passes: Count = Field(3, description="Passes over the control layers per frame.")
    step: Positive = Field(0.01, description="alpha_0, first trial step of the line search.")
    far_distance: NonNegative = Field(
        0.0,
        description="If the two-sided distance at the start of a frame exceeds this, steps grow in "
        "proportion [grid units]; 0: never.",
    )
    far_factor: float = Field(
        3.0, ge=1, description="Largest growth of steps beyond `far_distance`."
    )
    line_search_trials: int = Field(5, ge=1, le=30)
    line_search_factor: float = Field(0.5, gt=0, lt=1)
    target_norm: Positive = Field(2500.0, description="Gradient norm above which steps shrink.")
    smallest_scale: Fraction = Field(0.1, description="Lower bound of that shrinking factor.")
    beta1: float = Field(0.9, ge=0, lt=1)
    beta2: float = Field(0.999, ge=0, lt=1)
    epsilon: Positive = Field(1e-3, description="Added to the square root of the second moment.")
    shared_counter: bool = Field(
        False, description="One step counter for all layers of a frame, as published."
    )


class JointOptimizerConfig(OptimizerConfig):
    """Optimisation of one frame where two losses add up."""

    normalize_by: Literal["physics", "total"] = Field(
        "total", description="Gradient norm that scales the update."
    )


class DescentConfig(Section):
    """Descent of the methods that move points directly, by AMSGrad (algorithm 8.2)."""

    steps_per_frame: Count = Field(30, description="Optimiser steps per frame.")
    learning_rate: Positive = Field(0.01, description="Learning rate of AMSGrad [grid units].")
    beta1: float = Field(0.9, ge=0, lt=1, description="Decay of the first moment.")
    beta2: float = Field(0.999, ge=0, lt=1, description="Decay of the second moment.")
    epsilon: Positive = Field(
        1e-4,
        description="Epsilon of AMSGrad. Gradients of single points are smaller than the default, "
        "which stops the descent after a fraction of the way; 1e-8 converges.",
    )


class RegularizerConfig(Section):
    """Local regularisers of `dco` (algorithm 8.4)."""

    repulsion: NonNegative = Field(0.0, description="Weight of the repulsion of close points.")
    smoothness: NonNegative = Field(
        0.0, description="Weight of the distance to the mean of the neighbours."
    )
    volume: NonNegative = Field(0.0, description="Weight of the growth of the bounding box.")
    neighbors: int = Field(12, ge=1, le=64, description="Neighbours listed for each point.")
    repulsion_neighbors: int = Field(
        8, ge=1, le=64, description="Number of these, the nearest ones, that repel."
    )

    @model_validator(mode="after")
    def _listed(self) -> RegularizerConfig:
        if self.repulsion_neighbors > self.neighbors:
            raise ValueError("repulsion_neighbors must not exceed neighbors")
        return self


class WatchdogConfig(Section):
    """What makes a simulated step unacceptable."""

    cells_per_step: Positive = Field(0.5, description="Largest movement in one time step [dx].")


class RestartingWatchdogConfig(WatchdogConfig):
    """What makes a trial unacceptable, and what happens then."""

    restarts: int = Field(6, ge=0, le=20, description="Restarts of a frame at half the time step.")


class StoppingConfig(Section):
    """Early stopping on s->t (algorithm 6.5)."""

    patience: int = Field(
        0, ge=0, description="Stop after this many frames without improvement; 0: never."
    )
    earliest_frame: int = Field(30, ge=0)
    tolerance: NonNegative = Field(
        1e-4, description="Smaller improvements do not count [grid units]."
    )


class SharedConfig(Section):
    """What every method honours."""

    preset: str = Field("custom", description="Name and version of the preset it started from.")
    frames: int = Field(40, ge=1, le=10000)
    seed: int = Field(42, ge=0, lt=2**32, description="Random seed, also of the jitter.")
    precision: Literal["float32", "float64"] = "float32"
    f1_tau: Positive = Field(0.2, description="Threshold of F1 [grid units].")
    grid: GridConfig = GridConfig()
    sampling: SamplingConfig = SamplingConfig()
    placement: PlacementConfig = PlacementConfig()
    stopping: StoppingConfig = StoppingConfig()
