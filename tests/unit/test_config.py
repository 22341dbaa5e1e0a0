"""Configuration, presets and schedules (algorithm 0, 7)."""

from __future__ import annotations

import subprocess
import sys
from typing import Any, Literal

import numpy as np
import pytest

from morph_engine import methods, presets
from morph_engine.config import MorphConfig, setting_fields, stored_config
from morph_engine.errors import ConfigError
from morph_engine.optimization import joint_weights, physics_weights
from morph_engine.presets import configure


@pytest.mark.parametrize("name", presets.names())
def test_presets_survive_storage(name: str) -> None:
    """What a result stores is the configuration that made it, to the last bit."""
    config = configure(name)
    assert MorphConfig.model_validate_json(config.model_dump_json()) == config
    assert config.preset.startswith(f"{name}-")


def test_overrides_reach_their_field() -> None:
    """Dotted paths, typed as on a command line."""
    joint = {"method": "joint"}
    options = configure(
        "fast", joint | {"chamfer.weight": "5", "method.smoothing.late_frame": "none", "seed": "3"}
    )
    assert options.seed == 3
    assert options.method.chamfer.weight == 5
    assert options.method.smoothing.late_frame is None
    one = configure("fast", joint | {"smoothing.values": ".9", "smoothing.first_frames": "0,"})
    assert one.method.smoothing.values == (0.9,)


def test_settings_may_be_numpy_values() -> None:
    """Arrays and numbers of NumPy are what lists and plain numbers are, also inside others."""
    landmark = {"source": np.zeros(3), "target": np.array([1, 2, 3])}
    config = configure(
        "fast",
        {
            "placement.source.move": np.array([1.0, 2, 3]),
            "placement.target.move": [np.float32(0.5), np.int64(1), 2],
            "frames": np.int64(7),
            "grid.margin": np.float32(0.5),
            "landmarks": [landmark],
        },
    )
    assert config.placement.source.move == (1, 2, 3)
    assert config.placement.target.move == (0.5, 1, 2)
    assert (config.frames, config.grid.margin) == (7, 0.5)
    assert config.method.landmarks[0].target == (1, 2, 3)


@pytest.mark.parametrize("arguments", [(None,), ({"frames": 2},), ("fast", 5), ("fast", "frames")])
def test_arguments_of_configure_that_are_none_get_an_example(arguments: Any) -> None:
    """What stands in place of a preset or of the settings is named."""
    with pytest.raises(ConfigError, match=r"of type .*configure\(\"fast\", {\"frames\": 20}\)"):
        configure(*arguments)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"grid.half_extent": float("inf")}, "grid.half_extent = inf: input should be a finite"),
        ({"grid.half_extent": 1e308, "grid.dx": 1e-308}, "whole cells"),
        ({"placement.source.scale": float("inf")}, "placement.source.scale = inf"),
        ({"f1_tau": float("nan")}, "f1_tau = nan"),
        ({"depth": float("inf")}, "depth = inf"),
        ({"grid.margin": 16}, "grid.margin = 16 leaves no room"),
        ({"grid.margin": 100}, "Lower grid.margin, or raise grid.half_extent"),
        ({"placement.source.move": np.zeros(2)}, "placement.source.move"),
        ({7: 3}, "no setting called '7'"),
        ({"chamfer.wieght": 3}, "chamfer.weight"),
        ({"weight": 3}, "chamfer.weight"),
        ({"frames": 0}, "greater than or equal to 1"),
        ({"material.poisson_ratio": 0.5}, "less than 0.5"),
        ({"material.model": "jelly"}, "neo_hookean"),
        ({"method": "joint", "time.dt": 0.03}, "stability limit of 0.02196"),
        ({"method": "joint", "material.drag": 120}, "material.drag = 120 / s is too large"),
        ({"material.drag": 54}, "time steps of 0.01875 s"),
        ({"method": "mesh"}, "There is no method called 'mesh'. Available methods: flow"),
        ({"grid.dx": 0.7}, "whole cells"),
        ({"grid.half_extent": 150}, "4 to 250"),
        ({"method": "joint", "smoothing.values": "0.9,0.9"}, "one entry per value"),
        ({"chamfer.weight": 3}, "It belongs to joint"),
        ({"method": "dco", "material.drag": 1}, "belongs to flow, joint, physics, transport"),
        ({"method": "joint", "transport.sweeps": 1}, "belongs to transport"),
        ({"method": "dco", "basis.learning_rate": 1}, "belongs to shared_basis"),
        ({"method": "jont"}, "Did you mean 'joint'"),
        ({"method.name": "joint"}, "Set it with `method`"),
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
    for method in methods.names():
        fields = setting_fields(method)
        assert {path for path, field in fields.items() if not field.description} <= plain


@pytest.mark.parametrize("method", methods.names())
@pytest.mark.parametrize("preset", presets.general_names())
def test_every_method_has_every_general_preset(method: str, preset: str) -> None:
    """What a method says of a preset is valid, and comes back from JSON with its own type."""
    config = configure(preset, {"method": method})
    again = MorphConfig.model_validate_json(config.model_dump_json())
    assert again == config and type(again.method) is methods.options_of(method)


def test_a_preset_of_one_method_is_refused_by_others() -> None:
    """Without a method it names its own."""
    assert configure("fluid").method.name == "flow"
    with pytest.raises(ConfigError, match="'fluid' belongs to the method 'flow'") as caught:
        configure("fluid", {"method": "joint"})
    assert caught.value.remedy.endswith("one of fast, published, paper.")


def test_the_schema_tells_methods_apart() -> None:
    """The JSON schema has one entry a method, with its sentence, told apart by name."""
    schema = MorphConfig.model_json_schema()
    method = schema["properties"]["method"]
    assert method["discriminator"]["mapping"].keys() == set(methods.names())
    assert len(method["oneOf"]) == len(methods.names())
    sinkhorn = schema["$defs"]["SinkhornOptions"]
    assert sinkhorn["description"] == methods.options_of("sinkhorn").summary()
    assert sinkhorn["properties"]["rounds"]["minimum"] == 1


def test_published_schedule() -> None:
    """The weights of algorithm 7 at its corners."""
    joint = configure("published").method
    sections = joint.smoothing, joint.grid_loss, joint.chamfer
    at = {frame: joint_weights(*sections, frame) for frame in (0, 5, 6, 14, 15, 17, 20, 39)}
    assert [at[f].chamfer for f in (0, 5, 6, 15, 39)] == [0, 0, 1, 10, 10]
    assert [round(at[f].physics, 9) for f in (0, 15, 17, 20, 39)] == [1, 1, 0.8, 0.5, 0.5]
    assert [at[f].smoothing for f in (0, 14, 15, 39)] == [0.88, 0.9, 0.7, 0.7]
    assert at[17].reverse == pytest.approx(0.8)
    smoothing = configure("published", {"method": "physics"}).method.smoothing
    physics = [physics_weights(smoothing, frame) for frame in (0, 10, 30, 39)]
    assert [w.smoothing for w in physics] == [0.88, 0.9, 0.92, 0.92]
    assert all(w.chamfer == 0 and w.physics == 1 for w in physics)


def test_methods_are_known_without_taichi() -> None:
    """Configurations, presets and estimates of every method load no compiler and no SciPy."""
    code = (
        "import sys; from morph_engine import cost, methods, presets; "
        "[(presets.configure('fast', {'method': m}), cost.estimate(9, 9, 9, method=m)) "
        "for m in methods.names()]; print('taichi' in sys.modules, 'scipy' in sys.modules)"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stdout.split() == ["False", "False"], process.stderr


def test_options_of_an_unknown_method_are_kept_and_not_run() -> None:
    """A stored configuration of a method that is not installed is shown as it was."""
    stored = {"frames": 3, "method": {"name": "elsewhere", "strength": 2}}
    config = stored_config(stored)
    assert config.model_dump(mode="json")["method"] == stored["method"]
    with pytest.raises(ConfigError, match="no method called 'elsewhere'"):
        methods.find(config.method.name)


def test_an_option_may_not_hide_a_shared_setting() -> None:
    """Its path would mean two things."""
    with pytest.raises(ConfigError, match="an option called 'grid'"):

        class HidingOptions(methods.MethodOptions):
            """Refused."""

            name: Literal["hiding"] = "hiding"
            grid: int = 1
