"""Particle state of one frame, layer by layer (algorithm 2.7)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend

Array = NDArray[Any]


@dataclass
class Particles:
    """Host copy of a particle state.

    Attributes:
        x: Positions [dx], shape [n, 3].
        v: Velocities [dx/s], shape [n, 3].
        C: Affine velocity matrices [1/s], shape [n, 3, 3].
        F: Deformation gradients, shape [n, 3, 3].
    """

    x: Array
    v: Array
    C: Array
    F: Array

    @classmethod
    def at_rest(cls, positions: Array) -> "Particles":
        """Undeformed particles without velocity (algorithm 1.3)."""
        n = len(positions)
        return cls(
            x=np.array(positions),
            v=np.zeros((n, 3), positions.dtype),
            C=np.zeros((n, 3, 3), positions.dtype),
            F=np.tile(np.eye(3, dtype=positions.dtype), (n, 1, 1)),
        )

    def permuted(self, order: NDArray[np.intp]) -> "Particles":
        """The same particles in another order."""
        arrays = (self.x, self.v, self.C, self.F)
        return Particles(*(np.take(array, order, axis=0) for array in arrays))

    def scaled(self, factor: float) -> "Particles":
        """The same particles in another unit of length, of which one dx has so many."""
        return Particles(self.x * factor, self.v * factor, self.C, self.F)


class Layer:
    """Device arrays of one time level: x, v, C, F as in `Particles`."""

    def __init__(self, particle_count: int) -> None:
        device = backend.active()
        self.x: Any = device.vectors(particle_count)
        self.v: Any = device.vectors(particle_count)
        self.C = device.matrices(particle_count)
        self.F = device.matrices(particle_count)

    def upload(self, particles: Particles, order: NDArray[np.intp] | None = None) -> None:
        """Copy a host state to the device, in another order if one is given."""
        real = backend.active().numpy_real
        for name in ("x", "v", "C", "F"):
            values = getattr(particles, name)
            if order is not None:
                values = np.take(values, order, axis=0)
            getattr(self, name).from_numpy(np.ascontiguousarray(values, real))

    def download(self, order: NDArray[np.intp] | None = None) -> "Particles":
        """Copy the state to the host, in another order if one is given."""
        arrays = (array.to_numpy() for array in (self.x, self.v, self.C, self.F))
        if order is None:
            return Particles(*arrays)
        return Particles(*(np.take(array, order, axis=0) for array in arrays))

    def clear(self) -> None:
        """Set everything to zero."""
        _clear(self.x, self.v, self.C, self.F)


class Transition:
    """Device arrays of one time step: control U, its gradient, rotations R, nodes (v, M)."""

    def __init__(self, particle_count: int, node_count: int, *, rotations: bool) -> None:
        device = backend.active()
        self.U = device.matrices(particle_count)
        self.R = device.matrices(particle_count if rotations else 1)
        self.nodes: Any = device.vectors(node_count, 4)

    @cached_property
    def U_bar(self) -> Any:
        """Gradient by the control; a run forwards alone has none."""
        return backend.active().matrices(self.U.shape[0])


@ti.kernel
def _clear(
    x: ti.types.ndarray(), v: ti.types.ndarray(), C: ti.types.ndarray(), F: ti.types.ndarray()
):
    for p in range(x.shape[0]):
        x[p], v[p] = ti.zero(x[p]), ti.zero(v[p])
        C[p], F[p] = ti.zero(C[p]), ti.zero(F[p])
