"""Configuration, presets and schedules (algorithm 0, 7)."""

from __future__ import annotations

import pytest

from morph_engine import presets
from morph_engine.config import MorphConfig, field_paths
from morph_engine.errors import ConfigError
from morph_engine.optimization.schedule import frame_weights
from morph_engine.presets import configure


@pytest.mark.parametrize("name", presets.names())
def test_presets_survive_storage(name: str) -> None:
    """What a result stores is the configuration that made it, to the last bit."""
    config = configure(name)
    assert MorphConfig.model_validate_json(config.model_dump_json()) == config
    assert config.preset.startswith(f"{name}-")


def test_overrides_reach_their_field() -> None:
    """Dotted paths, typed as on a command line."""
    config = configure("fast", {"chamfer.weight": "5", "smoothing.late_frame": "none"})
    assert config.chamfer.weight == 5
    assert config.smoothing.late_frame is None
    config = configure("fast", {"smoothing.values": ".9", "smoothing.first_frames": "0,"})
    assert config.smoothing.values == (0.9,)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"chamfer.wieght": 3}, "chamfer.weight"),
        ({"weight": 3}, "chamfer.weight"),
        ({"frames": 0}, "greater than or equal to 1"),
        ({"material.poisson_ratio": 0.5}, "less than 0.5"),
        ({"material.model": "jelly"}, "neo_hookean"),
        ({"time.dt": 0.03}, "stable limit 0.02196"),
        ({"grid.dx": 0.7}, "whole cells"),
        ({"grid.half_extent": 150}, "4 to 250"),
        ({"smoothing.values": "0.9,0.9"}, "one entry per value"),
    ],
)
def test_bad_values_name_the_remedy(overrides: dict[str, object], words: str) -> None:
    """Unknown names get the nearest known one, values out of range their bound."""
    with pytest.raises(ConfigError, match=words.replace(".", r"\.")):
        configure("fast", overrides)


def test_unknown_preset() -> None:
    """The nearest known preset is named."""
    with pytest.raises(ConfigError, match="published"):
        configure("publishd")


def test_every_setting_is_described() -> None:
    """A setting has a description, or its name and choices say it all."""
    plain = {"material.model", "precision", "frames", "time.dt", "stopping.earliest_frame"}
    plain |= {f"optimizer.{name}" for name in ("beta1", "beta2", "line_search_trials")}
    plain |= {"optimizer.line_search_factor"}
    missing = {path for path, field in field_paths().items() if not field.description}
    assert missing <= plain


def test_published_schedule() -> None:
    """The weights of algorithm 7 at its corners."""
    config = configure("published")
    at = {f: frame_weights(config, f, with_chamfer=True) for f in (0, 5, 6, 14, 15, 17, 20, 39)}
    assert [at[f].chamfer for f in (0, 5, 6, 15, 39)] == [0, 0, 1, 10, 10]
    assert [round(at[f].physics, 9) for f in (0, 15, 17, 20, 39)] == [1, 1, 0.8, 0.5, 0.5]
    assert [at[f].smoothing for f in (0, 14, 15, 39)] == [0.88, 0.9, 0.7, 0.7]
    assert at[17].reverse == pytest.approx(0.8)
    physics = [frame_weights(config, f, with_chamfer=False) for f in (0, 10, 30, 39)]
    assert [w.smoothing for w in physics] == [0.88, 0.9, 0.92, 0.92]
    assert all(w.chamfer == 0 and w.physics == 1 for w in physics)
