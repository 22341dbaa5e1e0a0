"""Losses over matched pairs: every particle with its nearest target point, and the reverse."""

from abc import ABC, abstractmethod
from typing import Any

import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.losses.matches import Matches


class PairLoss(ABC):
    """A loss whose gradient is a pull along every pair.

    A pair of a particle x and a target point q with strength c adds c (x - q) to the gradient of
    that particle. Assignments count as constants, so a loss l(|x - q|) has c = l'(d) / d. Matches
    are updated by whoever moves the particles.
    """

    def __init__(self, matches: Matches) -> None:
        device = backend.active()
        self.matches = matches
        self._forward = device.scalars(matches.forward.shape[0])
        self._reverse = device.scalars(matches.reverse.shape[0])

    @abstractmethod
    def value(self) -> float:
        """The loss at the matches as they are."""

    @abstractmethod
    def gradient(self, x: Any, gradient: Any) -> None:
        """Set `gradient` [n, 3] to that at particles x [dx], shape [n, 3], matched last."""

    def _set_strengths(self, forward: NDArray[Any], reverse: NDArray[Any]) -> None:
        """Upload the strength of the pairs of every particle, [n], and target point, [m]."""
        real = backend.active().numpy_real
        self._forward.from_numpy(forward.astype(real))
        self._reverse.from_numpy(reverse.astype(real))

    def _pull(self, x: Any, gradient: Any) -> None:
        """Set the gradient by the strengths set last."""
        on_cpu, m = backend.active().on_cpu, self.matches
        lanes = 1 if on_cpu else m.target.shape[0]
        _pull(
            x, m.target, m.forward, m.reverse, self._forward, self._reverse, gradient,
            lanes, not on_cpu,
        )  # fmt: skip


@ti.kernel
def _pull(
    x: ti.types.ndarray(),
    target: ti.types.ndarray(),
    forward: ti.types.ndarray(),
    reverse: ti.types.ndarray(),
    forward_strength: ti.types.ndarray(),
    reverse_strength: ti.types.ndarray(),
    gradient: ti.types.ndarray(),
    lanes: int,
    atomic: ti.template(),
):
    """Both pulls on every particle; the reverse ones on the CPU in target order."""
    for p in range(x.shape[0]):
        pull = ti.Vector.zero(float, 3)
        if forward[p] >= 0:
            pull = forward_strength[p] * (x[p] - target[forward[p]])
        gradient[p] = pull
    chunk = (target.shape[0] + lanes - 1) // lanes
    for lane in range(lanes):
        for j in range(lane * chunk, ti.min((lane + 1) * chunk, target.shape[0])):
            p = reverse[j]
            if p >= 0:
                pull = reverse_strength[j] * (x[p] - target[j])
                if ti.static(atomic):
                    ti.atomic_add(gradient[p], pull)
                else:
                    gradient[p] = gradient[p] + pull
