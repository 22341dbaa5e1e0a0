"""Differentiable MPM driven by grid mass and Chamfer distance together (algorithm 5, 7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from morph_engine import losses, optimization
from morph_engine.methods.physics import ControlMethod, ControlOptions
from morph_engine.sections import (
    ChamferConfig,
    JointOptimizerConfig,
    SmoothingConfig,
    WeightedGridLossConfig,
)

if TYPE_CHECKING:
    from morph_engine.losses import GridMassLoss
    from morph_engine.optimization import FrameOptimizer, FrameWeights


class LateSmoothingConfig(SmoothingConfig):
    """Blend s of the new deformation gradient with the old one (algorithm 2.6)."""

    late_frame: int | None = Field(
        15, ge=0, description="Frame from which `late_value` applies; None: never."
    )


class JointOptions(ControlOptions):
    """Physics first, then the bidirectional Chamfer distance as well; the paper's own method."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        # closer to the target than the published settings, in a third of their time:
        # docs/presets.md
        "fast": {
            "material": {"drag": 4.0},
            "adjoint": {"drop_smoothing": True},
            "chamfer": {"reverse_smoothing": 0.0},
            "optimizer": {"layers_per_step": 3, "passes": 2, "step": 0.006, "far_distance": 0.5},
        },
        # what the authors' program does (algorithm 11.2, H0 of 7.3)
        "published": {
            "material": {"model": "fixed_corotated"},
            "adjoint": {"drop_smoothing": True, "carry_control": True, "drop_drag": True},
            "chamfer": {"neighborhood": "published"},
            "optimizer": {"normalize_by": "physics", "shared_counter": True},
        },
        # the text of the paper taken literally (algorithm 11)
        "paper": {
            "time": {"transitions_per_frame": 10},
            "smoothing": {"values": (0.955,), "first_frames": (0,)},
            "grid_loss": {
                "outside_factor": 1.0,
                "final_weight": 0.1,
                "weight_mode": "literal",
            },
            "chamfer": {"normalize": False, "huber_delta": 0.0, "reverse_smoothing": 0.0},
        },
    }

    name: Literal["joint"] = "joint"
    smoothing: LateSmoothingConfig = LateSmoothingConfig()
    grid_loss: WeightedGridLossConfig = WeightedGridLossConfig()
    chamfer: ChamferConfig = ChamferConfig()
    optimizer: JointOptimizerConfig = JointOptimizerConfig()


class Joint(ControlMethod[JointOptions]):
    """The grid mass loss, and from some frame on the Chamfer loss beside it."""

    def _make_control(self, grid_loss: GridMassLoss) -> FrameOptimizer:
        options = self.options
        return optimization.FrameOptimizer(
            self._simulation,
            grid_loss,
            losses.ChamferLoss(self._matches, options.chamfer, self._grid),
            config=options.optimizer,
            restarts=options.watchdog.restarts,
            normalize_by=options.optimizer.normalize_by,
            weight_mode=options.grid_loss.weight_mode,
        )

    def _weights(self, frame: int) -> FrameWeights:
        options = self.options
        return optimization.joint_weights(
            options.smoothing, options.grid_loss, options.chamfer, frame
        )
