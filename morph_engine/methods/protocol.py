"""What a method must offer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from morph_engine.config import MorphConfig
from morph_engine.optimization.events import Event


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be morphed into what.

    Attributes:
        source: Particle positions at the start [dx], shape [n, 3], float32.
        target: Target points [dx], shape [m, 3], float32.
        config: The configuration.
    """

    source: NDArray[np.float32]
    target: NDArray[np.float32]
    config: MorphConfig


@dataclass(frozen=True, eq=False)
class FrameOutcome:
    """The state after a frame, particles in their original order.

    Attributes:
        positions: Particle positions [dx], shape [n, 3], float32.
        d_fwd: Distance from each particle to its nearest target point [dx], shape [n].
        nearest_fwd: Index of that target point, shape [n].
        d_rev: Distance from each target point to its nearest particle [dx], shape [m].
        deformation: Deformation gradients, shape [n, 3, 3]; None for methods without them.
        numbers: Further metrics of the frame by name, e.g. losses.
        events: What the watchdog did.
    """

    positions: NDArray[np.float32]
    d_fwd: NDArray[Any]
    nearest_fwd: NDArray[np.int32]
    d_rev: NDArray[Any]
    deformation: NDArray[Any] | None = None
    numbers: dict[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()


class Method(ABC):
    """One morph by one method; frames are advanced in order.

    Subclasses document themselves in one sentence, the first line of their docstring.
    """

    name: ClassVar[str]

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

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

    @classmethod
    def summary(cls) -> str:
        """One sentence on the method."""
        return (cls.__doc__ or "").strip().partition("\n")[0]
