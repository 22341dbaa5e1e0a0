"""Weights and smoothing over frames (algorithm 7)."""

from __future__ import annotations

from dataclasses import dataclass

from morph_engine.sections import (
    ChamferConfig,
    SmoothingConfig,
    WeightedGridLossConfig,
)


@dataclass(frozen=True)
class FrameWeights:
    """The scheduled numbers of one frame.

    Attributes:
        smoothing: s of the deformation gradient update.
        chamfer: w_ch; 0 leaves the Chamfer term out.
        physics: w_phys.
        reverse: w_rev, weight of target->source inside the Chamfer term.
    """

    smoothing: float
    chamfer: float
    physics: float
    reverse: float


def physics_weights(smoothing: SmoothingConfig, frame: int) -> FrameWeights:
    """The weights of a frame (0-based) without a Chamfer term."""
    return FrameWeights(_smoothing(smoothing, frame), chamfer=0.0, physics=1.0, reverse=1.0)


def joint_weights(
    smoothing: SmoothingConfig,
    grid_loss: WeightedGridLossConfig,
    chamfer: ChamferConfig,
    frame: int,
) -> FrameWeights:
    """The weights of a frame (0-based) with a Chamfer term."""
    physics = _physics_weight(grid_loss, frame)
    return FrameWeights(
        smoothing=_smoothing(smoothing, frame),
        chamfer=_chamfer_weight(chamfer, frame),
        physics=physics,
        reverse=chamfer.reverse_weight * (physics if chamfer.reverse_coupled else 1.0),
    )


def _chamfer_weight(chamfer: ChamferConfig, frame: int) -> float:
    ramp = (frame - chamfer.start_frame) / chamfer.ramp_frames
    return chamfer.weight * min(max(ramp, 0.0), 1.0)


def _physics_weight(loss: WeightedGridLossConfig, frame: int) -> float:
    progress = min(max((frame - loss.decay_start) / loss.decay_frames, 0.0), 1.0)
    return 1.0 + (loss.final_weight - 1.0) * progress


def _smoothing(smoothing: SmoothingConfig, frame: int) -> float:
    if smoothing.late_frame is not None and frame >= smoothing.late_frame:
        return smoothing.late_value
    phase = sum(start <= frame for start in smoothing.first_frames) - 1
    return smoothing.values[phase]
