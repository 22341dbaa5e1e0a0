"""What the methods share that simulate matter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from morph_engine.config import MorphConfig
from morph_engine.mpm import step
from morph_engine.mpm.constitutive import FIXED_COROTATED, NEO_HOOKEAN
from morph_engine.mpm.kernel import Geometry

MODELS = {"neo_hookean": NEO_HOOKEAN, "fixed_corotated": FIXED_COROTATED}


def grid_geometry(config: MorphConfig) -> Geometry:
    """The background grid of a configuration."""
    return Geometry(
        dx=config.grid.dx,
        half_extent=config.grid.half_extent,
        width=4 if config.grid.kernel == "cubic" else 3,
    )


def particle_mass(config: MorphConfig) -> float:
    """Mass of every particle."""
    return config.material.density * config.spacing**3


def make_simulation(
    config: MorphConfig, rest_volume: NDArray[Any], *, transitions: int
) -> step.Simulation:
    """A simulation of the material on the grid of a configuration.

    Args:
        config: The configuration.
        rest_volume: Rest volumes [dx^3], shape [n].
        transitions: Time steps that are kept at a time.
    """
    return step.Simulation(
        rest_volume,
        geometry=grid_geometry(config),
        physics=step.Physics(
            model=MODELS[config.material.model],
            lame_lambda=config.material.lame_lambda,
            lame_mu=config.material.lame_mu,
            particle_mass=particle_mass(config),
            drag=config.material.drag,
            dt=config.time.dt,
        ),
        transitions=transitions,
        domain=config.domain,
        largest_cells_per_step=config.watchdog.cells_per_step,
        adjoint=step.AdjointFlags(**config.adjoint.model_dump()),
    )


def cell_order(x: NDArray[Any], geometry: Geometry) -> NDArray[np.intp]:
    """Particles by grid cell, z fastest: neighbours in space become neighbours in memory.

    Args:
        x: Positions [dx], shape [n, 3].
        geometry: The grid.
    """
    cell = np.floor((x - geometry.origin) / geometry.dx).astype(np.int64)
    key = (cell[:, 0] * geometry.nodes + cell[:, 1]) * geometry.nodes + cell[:, 2]
    return np.argsort(key, kind="stable")
