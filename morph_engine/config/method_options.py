"""What a method declares: its options, its values under the presets and its cost.

Every class of options with a name is known from its definition on. The modules of
`morph_engine.methods` and those that other packages name by an entry point of the group
`morph.methods` are imported when somebody asks for methods; they must not import Taichi.
"""

from __future__ import annotations

import pkgutil
import warnings
from collections.abc import Mapping
from functools import cache
from importlib import import_module, metadata
from typing import Any, ClassVar, NamedTuple

from morph_engine.config.sections import GridConfig, Section, SharedConfig
from morph_engine.errors import ConfigError, unknown_name

ENTRY_POINTS = "morph.methods"
"""Entry points of this group name modules, or classes, that define methods."""

DEFAULT_METHOD = "transport"


class CostRates(NamedTuple):
    """What one point costs: CPU seconds per frame, and kilobytes; and a frame on the usual grid."""

    seconds_per_particle: float
    seconds_per_target: float
    kilobytes_per_particle: float
    kilobytes_per_target: float
    seconds_per_frame: float = 0.0


class MethodOptions(Section):
    """Options of a method; a subclass declares `name` as a literal, which is its default as well.

    The first line of its docstring is what lists of methods say. A field must not have the name of
    a setting that all methods share.

    Attributes:
        presets: Values under presets, nested, by the name of the preset.
        cost: What a run costs; by default as much as differentiable simulation.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    cost: ClassVar[CostRates] = CostRates(40e-6, 4e-6, 5.2, 0.2)

    name: str

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Make the method known.

        Raises:
            ConfigError: Its name is taken, or a field has the name of a shared setting.
        """
        name = cls.model_fields["name"].default
        if not isinstance(name, str):
            return  # a base of several methods
        if shared := cls.model_fields.keys() & {"method", *SharedConfig.model_fields}:
            raise ConfigError(
                f"Method {name!r} has an option called {min(shared)!r}, as all methods have.",
                "Choose another name for the option.",
            )
        other = _known.get(name, cls)
        if (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
            raise ConfigError(f"There is a method called {name!r}.", "Choose another name.")
        _known[name] = cls

    @classmethod
    def summary(cls) -> str:
        """One sentence on the method."""
        return (cls.__doc__ or "").strip().partition("\n")[0]

    def check_grid(self, grid: GridConfig) -> None:
        """Check the options against the grid that they shall hold on.

        Raises:
            ValueError: They do not go together.
        """


class ForeignOptions(MethodOptions, extra="allow"):
    """Stored options of a method that is not installed, or that is of another version.

    They are shown as they were stored, and cannot be run.
    """


_known: dict[str, type[MethodOptions]] = {}


def names() -> tuple[str, ...]:
    """Names of all methods, the default first."""
    _discover()
    return (DEFAULT_METHOD, *sorted(_known.keys() - {DEFAULT_METHOD}))


def options_of(name: str) -> type[MethodOptions]:
    """The options of a method.

    Raises:
        ConfigError: There is no such method.
    """
    _discover()
    if name not in _known:
        raise unknown_name("method", name, names())
    return _known[name]


@cache
def _discover() -> None:
    """Import every module that defines methods; one of another package that fails is left out."""
    package = import_module("morph_engine.methods")
    for module in pkgutil.iter_modules(package.__path__):
        import_module(f"{package.__name__}.{module.name}")
    for entry_point in metadata.entry_points(group=ENTRY_POINTS):
        try:
            entry_point.load()
        except Exception as error:
            warnings.warn(
                f"Methods of {entry_point.value} cannot be used: {error}", RuntimeWarning, 2
            )
