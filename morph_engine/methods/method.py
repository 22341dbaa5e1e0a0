"""What a method must offer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from morph_engine.errors import ConfigError
from morph_engine.methods.options import MethodConfig, MethodOptions

if TYPE_CHECKING:
    from morph_engine.backend import Backend
    from morph_engine.geometry.mesh import Mesh
    from morph_engine.optimization import Event

OptionsT = TypeVar("OptionsT", bound=MethodOptions)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be morphed into what.

    Attributes:
        source: Particle positions at the start [dx], shape [n, 3], float32.
        target: Target points [dx], shape [m, 3], float32.
        config: The configuration.
        source_mesh: The mesh that the source fills [dx]; None for a point cloud.
        target_mesh: The mesh that the target fills [dx]; None for a point cloud.
        source_to_grid: Maps coordinates of the source as it was given to grid units, shape [4, 4].
        target_to_grid: Likewise for the target.
    """

    source: NDArray[np.float32]
    target: NDArray[np.float32]
    config: MethodConfig
    source_mesh: Mesh | None = None
    target_mesh: Mesh | None = None
    source_to_grid: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    target_to_grid: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True, eq=False)
class FrameOutcome:
    """The state after a frame, particles in their original order.

    Attributes:
        positions: Particle positions [dx], shape [n, 3], float32.
        d_fwd: Distance from each particle to its nearest target point [dx], shape [n].
        nearest_fwd: Index of that target point, shape [n].
        d_rev: Distance from each target point to its nearest particle [dx], shape [m].
        gap: Distance from each particle to the nearest other one [dx], shape [n]; inf where it is
            not below the lattice spacing. None where the method does not know it.
        deformation: Deformation gradients, shape [n, 3, 3]; None for methods without them.
        numbers: Further metrics of the frame by name, e.g. losses.
        events: What the watchdog did.
    """

    positions: NDArray[np.float32]
    d_fwd: NDArray[Any]
    nearest_fwd: NDArray[np.int32]
    d_rev: NDArray[Any]
    gap: NDArray[Any] | None = None
    deformation: NDArray[Any] | None = None
    numbers: dict[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()


class Method(ABC, Generic[OptionsT]):
    """One morph by one method; frames are advanced in order.

    Attributes:
        Options: Class of the method's options: the type argument of its base, as in
            `class Own(Method[OwnOptions])`.
        problem: What is to be morphed into what.
    """

    Options: ClassVar[type[MethodOptions]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for base in vars(cls).get("__orig_bases__", ()):
            for argument in get_args(base):
                if isinstance(argument, type) and issubclass(argument, MethodOptions):
                    cls.Options = argument
                    classes[argument] = cls

    def __init__(self, problem: Problem) -> None:
        options = problem.config.method
        if type(options) is not self.Options:
            raise ConfigError(
                f"The installed version of the method {self.name!r} does not accept these options.",
                "Install the version of the method that wrote them, or start a new run.",
            )
        self.problem = problem
        self.options: OptionsT = options  # type: ignore[assignment]

    @property
    def name(self) -> str:
        """Name of the method."""
        return str(self.Options.model_fields["name"].default)

    @property
    def device(self) -> Backend:
        """Where the run computes, which makes its arrays."""
        from morph_engine import backend  # which loads Taichi

        return backend.active()

    @abstractmethod
    def advance(self, frame: int) -> FrameOutcome:
        """Compute one frame.

        Raises:
            SimulationError: The frame cannot be completed; the state is that of the frame before.
        """

    @abstractmethod
    def state(self) -> dict[str, NDArray[Any]]:
        """Everything needed to go on after the last frame, bit for bit."""

    @abstractmethod
    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""


classes: dict[type[MethodOptions], type[Method[Any]]] = {}
"""The class of each method by that of its options."""
