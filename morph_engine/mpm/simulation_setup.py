"""The simulation that a configuration describes."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from morph_engine.config import MorphConfig
from morph_engine.mpm.constitutive import FIXED_COROTATED, NEO_HOOKEAN
from morph_engine.mpm.grid import Grid
from morph_engine.mpm.simulation import AdjointFlags, Material, Simulation

MODELS = {"neo_hookean": NEO_HOOKEAN, "fixed_corotated": FIXED_COROTATED}


def make_grid(config: MorphConfig) -> Grid:
    """The background grid of a configuration."""
    return Grid(
        dx=config.grid.dx,
        half_extent=config.grid.half_extent,
        width=4 if config.grid.kernel == "cubic" else 3,
    )


def particle_mass(config: MorphConfig) -> float:
    """Mass of every particle."""
    return config.material.density * config.spacing**3


def make_simulation(
    config: MorphConfig, rest_volume: NDArray[Any], *, transitions: int
) -> Simulation:
    """A simulation of the material on the grid of a configuration.

    Args:
        config: The configuration.
        rest_volume: Rest volumes [dx^3], shape [n].
        transitions: Time steps that are kept at a time.
    """
    return Simulation(
        rest_volume,
        grid=make_grid(config),
        material=Material(
            model=MODELS[config.material.model],
            lame_lambda=config.material.lame_lambda,
            lame_mu=config.material.lame_mu,
            particle_mass=particle_mass(config),
            drag=config.material.drag,
        ),
        dt=config.time.dt,
        transitions=transitions,
        domain=config.domain,
        largest_cells_per_step=config.watchdog.cells_per_step,
        adjoint=AdjointFlags(**config.adjoint.model_dump()),
    )
