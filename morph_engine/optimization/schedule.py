"""Weights and smoothing over frames (algorithm 7)."""

from __future__ import annotations

from dataclasses import dataclass

from morph_engine.config import MorphConfig


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


def frame_weights(config: MorphConfig, frame: int, *, with_chamfer: bool) -> FrameWeights:
    """The weights of a frame.

    Args:
        config: The configuration.
        frame: 0-based frame index.
        with_chamfer: Whether the method has a Chamfer term; without one w_phys stays 1.
    """
    physics = _physics_weight(config, frame) if with_chamfer else 1.0
    reverse = config.chamfer.reverse_weight
    return FrameWeights(
        smoothing=_smoothing(config, frame, with_chamfer),
        chamfer=_chamfer_weight(config, frame) if with_chamfer else 0.0,
        physics=physics,
        reverse=reverse * physics if config.chamfer.reverse_coupled else reverse,
    )


def _chamfer_weight(config: MorphConfig, frame: int) -> float:
    ramp = (frame - config.chamfer.start_frame) / config.chamfer.ramp_frames
    return config.chamfer.weight * min(max(ramp, 0.0), 1.0)


def _physics_weight(config: MorphConfig, frame: int) -> float:
    loss = config.grid_loss
    progress = min(max((frame - loss.decay_start) / loss.decay_frames, 0.0), 1.0)
    return 1.0 + (loss.final_weight - 1.0) * progress


def _smoothing(config: MorphConfig, frame: int, with_chamfer: bool) -> float:
    s = config.smoothing
    late = s.late_frame if with_chamfer else s.late_frame_physics
    if late is not None and frame >= late:
        return s.late_value
    phase = sum(start <= frame for start in s.first_frames) - 1
    return s.values[phase]
