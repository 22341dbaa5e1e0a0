"""Presets: complete, versioned configurations. A changed number is a new version."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from morph_engine.config import MorphConfig, override, validated
from morph_engine.errors import unknown_name

DEFAULT = "fast"

# What the authors' program does (algorithm 11.2, H0 of 7.3).
_PUBLISHED: dict[str, Any] = {
    "method": "joint",
    "material": {"model": "fixed_corotated"},
    "adjoint": {"drop_smoothing": True, "carry_control": True, "drop_drag": True},
    "chamfer": {"neighborhood": "published"},
    "optimizer": {
        "normalise_by": "physics",
        "shared_counter": True,
    },
}

# The text of the paper taken literally (algorithm 11).
_PAPER: dict[str, Any] = {
    "method": "joint",
    "smoothing": {"values": (0.955,), "first_frames": (0,)},
    "grid_loss": {
        "outside_factor": 1.0,
        "final_weight": 0.1,
        "decay_start": 20,
        "weight_mode": "literal",
    },
    "chamfer": {"normalise": False, "huber_delta": 0.0, "reverse_smoothing": 0.0},
}

# For `joint`: closer to the target than the published settings, in a third of their time;
# docs/presets.md.
_FAST: dict[str, Any] = {
    "material": {"drag": 4.0},
    "smoothing": {"late_frame_physics": 12},
    "adjoint": {"drop_smoothing": True},
    "chamfer": {"reverse_smoothing": 0.0},
    "optimizer": {"layers_per_step": 3, "passes": 2, "step": 0.006, "far_distance": 0.5},
}

_PRESETS: dict[str, tuple[int, str, dict[str, Any]]] = {
    "fast": (3, "The default: an even fill by transport; joint in a third of its time.", _FAST),
    "published": (1, "The authors' program, number for number.", _PUBLISHED),
    "paper": (1, "The text of the paper, taken literally.", _PAPER),
}


def names() -> tuple[str, ...]:
    """Names of the presets, the default first."""
    return tuple(_PRESETS)


def describe(name: str) -> str:
    """One sentence on a preset."""
    return _find(name)[1]


def configure(preset: str = DEFAULT, overrides: Mapping[str, Any] | None = None) -> MorphConfig:
    """The configuration of a preset with fields replaced by dotted path.

    Raises:
        ConfigError: Unknown preset or field, or a value out of range.
    """
    version, _, changes = _find(preset)
    config = validated({"preset": f"{preset}-{version}", **changes})
    return override(config, overrides or {})


def _find(name: str) -> tuple[int, str, dict[str, Any]]:
    if name not in _PRESETS:
        raise unknown_name("preset", name, _PRESETS)
    return _PRESETS[name]
