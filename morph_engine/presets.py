"""Presets: complete, versioned configurations. A changed number is a new version."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from morph_engine.config import MorphConfig, override, validated
from morph_engine.errors import ConfigError, unknown_name
from morph_engine.methods.registry import DEFAULT_METHOD, options_of

if TYPE_CHECKING:
    from morph_engine.geometry.sampling import Fit

DEFAULT = "fast"
_EXAMPLE = 'Give a preset first and settings second, as in configure("fast", {"frames": 20}).'


class Preset(NamedTuple):
    """A preset; values of a method's options are with the method.

    Attributes:
        version: Changes with any number.
        summary: One sentence.
        method: The method if none is asked for.
        only: Whether it means nothing to other methods.
        fit: How shapes are placed, as `sampling.fit`.
    """

    version: int
    summary: str
    method: str
    only: bool = False
    fit: Fit = "auto"


_PRESETS = {
    "fast": Preset(
        5, "The default: one body that flows; for joint, a third of the usual time.", DEFAULT_METHOD
    ),
    "published": Preset(1, "The authors' program, number for number.", "joint", fit="none"),
    "paper": Preset(2, "The text of the paper, taken literally.", "joint", fit="none"),
    "stiff": Preset(2, "Flow of matter that resists shear for long.", "flow", only=True),
    "soft": Preset(2, "Flow of soft matter with some inertia.", "flow", only=True),
    "viscous": Preset(2, "Flow of matter that creeps and melts a little.", "flow", only=True),
    "fluid": Preset(
        2, "Flow of a drop: no resistance to shear, high surface tension.", "flow", only=True
    ),
}


def names() -> tuple[str, ...]:
    """Names of the presets, the default first."""
    return tuple(_PRESETS)


def general_names() -> tuple[str, ...]:
    """Names of the presets that every method has."""
    return tuple(name for name, preset in _PRESETS.items() if not preset.only)


def describe(name: str) -> str:
    """One sentence on a preset."""
    return _find(name).summary


def configure(preset: str = DEFAULT, overrides: Mapping[str, Any] | None = None) -> MorphConfig:
    """The configuration of a preset with settings replaced by dotted path.

    Args:
        preset: Name of the preset.
        overrides: Settings by dotted path; `method` is the name of a method, whose values under the
            preset the others replace.

    Raises:
        ConfigError: Unknown preset, method or setting, a preset of another method, a value out of
            range, or settings that are no mapping.
    """
    found = _find(preset)
    settings = {} if overrides is None else overrides
    if not isinstance(settings, Mapping):
        raise ConfigError(
            f"Settings are a mapping, not of type {type(settings).__name__}.", _EXAMPLE
        )
    settings = dict(settings)
    method = str(settings.pop("method", found.method))
    if found.only and method != found.method:
        raise ConfigError(
            f"The preset {preset!r} belongs to the method {found.method!r}.",
            f"Omit the method, or choose one of {', '.join(general_names())}.",
        )
    options = {"name": method, **options_of(method).presets.get(preset, {})}
    config = validated(
        {
            "preset": f"{preset}-{found.version}",
            "method": options,
            "sampling": {"fit": found.fit},
        }
    )
    return override(config, settings)


def _find(name: str) -> Preset:
    if not isinstance(name, str):
        raise ConfigError(
            f"The name of a preset is a string, not of type {type(name).__name__}.", _EXAMPLE
        )
    if name not in _PRESETS:
        raise unknown_name("preset", name, _PRESETS)
    return _PRESETS[name]
