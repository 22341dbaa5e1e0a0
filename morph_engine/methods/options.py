"""What a method declares: its options, its values under the presets and its cost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from pydantic import SerializeAsAny, model_validator

from morph_engine.errors import ConfigError
from morph_engine.sections import GridConfig, Section, SharedConfig


class CostRates(NamedTuple):
    """What one point costs: CPU seconds per frame, and kilobytes; and a frame on the usual grid.

    Last what a node of the grid takes [bytes].
    """

    seconds_per_particle: float
    seconds_per_target: float
    kilobytes_per_particle: float
    kilobytes_per_target: float
    seconds_per_frame: float = 0.0
    bytes_per_node: float = 0.0


class MethodOptions(Section):
    """Options of a method; a subclass declares `name` as a literal, which is its default as well.

    The first line of its docstring is what lists of methods say. A field must not have the name of
    a setting that all methods share.

    Attributes:
        presets: Values under presets, nested, by the name of the preset.
        cost: What a run costs; by default as much as differentiable simulation.
        fixed: Options, or `frames`, that cannot change within a run: a fork keeps them.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    cost: ClassVar[CostRates] = CostRates(40e-6, 4e-6, 5.2, 0.2)
    fixed: ClassVar[tuple[str, ...]] = ()

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
                f"Method {name!r} has an option called {min(shared)!r}, which all methods "
                "already have.",
                "Choose another name for the option.",
            )
        other = declared.get(name, cls)
        if (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
            raise ConfigError(f"A method called {name!r} already exists.", "Choose another name.")
        declared[name] = cls

    @classmethod
    def summary(cls) -> str:
        """One sentence on the method."""
        return (cls.__doc__ or "").strip().partition("\n")[0]

    def node_count(self, config: MethodConfig, *, radius: float, ratio: float) -> int:
        """Nodes of the grid of a run; 0 without one.

        Args:
            config: The configuration that these options are in.
            radius: Of the ball around the origin that holds both shapes [dx].
            ratio: Target points over particles.
        """
        return 0

    def share_of_change(self, frame: float, frames: int) -> float:
        """Share of the change from source to target that is to be made after so many frames of all.

        Even steps, where a method has no schedule of its own.
        """
        return frame / frames

    def check_legs(self, count: int) -> None:
        """Refuse a morph through several shapes, where options are about a source and a target.

        Args:
            count: Number of targets, at least 2.

        Raises:
            ConfigError: They do not go together.
        """

    def check_grid(self, grid: GridConfig) -> None:
        """Check the options against the grid that they shall hold on.

        Raises:
            ValueError: They do not go together.
        """


declared: dict[str, type[MethodOptions]] = {}
"""Every class of options with a name, from its definition on."""


class MethodConfig(SharedConfig):
    """What all methods share, and the options of one method."""

    method: SerializeAsAny[MethodOptions]

    @property
    def spacing(self) -> float:
        """Lattice spacing h [grid units]."""
        return self.grid.dx / self.sampling.points_per_cell_edge

    @property
    def domain(self) -> float:
        """Particles stay in [-domain, domain]^3 [grid units]."""
        return self.grid.half_extent - self.grid.margin * self.grid.dx

    @model_validator(mode="after")
    def _consistent(self) -> MethodConfig:
        self.method.check_grid(self.grid)
        return self
