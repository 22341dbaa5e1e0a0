"""The engine on the benchmark scene: its layers, fed and read like a peer's."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.scene import DRAG, DT, GRID_MIN, LAMBDA, MU, SMOOTHING, Layer, Scene
from morph_engine import backend
from morph_engine.mpm.constitutive import NEO_HOOKEAN
from morph_engine.mpm.grid import Grid
from morph_engine.mpm.simulation import Material, Simulation
from morph_engine.mpm.state import Particles


class EngineStep:
    """A `Stepper` over `step_count` transitions, and their adjoint.

    Particles are sorted by cell, as the engine does once a frame (about 27 sweeps of 9 steps).
    """

    name: ClassVar[str] = "morph_engine"

    def __init__(self, scene: Scene, step_count: int = 1) -> None:
        backend.start("cpu")
        layer = scene.layer
        cell = np.floor(layer.x - GRID_MIN)
        order = np.lexsort((cell[:, 2], cell[:, 1], cell[:, 0]))
        self._original = np.argsort(order)
        self.simulation = Simulation(
            scene.volume[order],
            grid=Grid(),
            material=Material(
                model=NEO_HOOKEAN,
                lame_lambda=LAMBDA,
                lame_mu=MU,
                particle_mass=scene.mass,
                drag=DRAG,
            ),
            dt=DT,
            transitions=step_count,
            domain=-GRID_MIN,
        )
        self.simulation.smoothing = SMOOTHING
        first = Particles(layer.x, layer.v, layer.C, layer.F)
        self.simulation.layers[0].upload(first.permuted(order))
        for transition in self.simulation.transitions:
            transition.U.from_numpy(np.ascontiguousarray(scene.U[order]))

    def advance(self) -> None:
        """All transitions forward."""
        faults = self.simulation.forward()
        if faults:
            raise AssertionError(f"The benchmark scene raised the faults {faults:#b}")

    def result(self) -> Layer:
        """Return the last layer, particles in the order of the scene."""
        last = self.simulation.last.download().permuted(self._original)
        return Layer(last.x, last.v, last.C, last.F)

    def hold(self, gradient: NDArray[np.float32]) -> None:
        """Keep a gradient by the last positions on the device, for `pull`."""
        self._gradient = backend.active().upload(gradient[np.argsort(self._original)])

    def pull(self) -> None:
        """Set the adjoint state: the held gradient on the last positions, zero on the rest."""
        self.simulation.bar.clear()
        self.simulation.bar.x.copy_from(self._gradient)

    def sweep_back(self) -> None:
        """Adjoint of all transitions; `pull` sets what it starts from."""
        self.simulation.backward()

    def control_gradients(self) -> list[NDArray[np.float32]]:
        """Return d loss / d U of every transition, each [particle_count, 3, 3]."""
        return [t.U_bar.to_numpy()[self._original] for t in self.simulation.transitions]
