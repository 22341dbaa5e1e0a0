"""What a time step's kernels are compiled for."""

from dataclasses import dataclass

from morph_engine.sections import AdjointConfig

EXACT = AdjointConfig()
PUBLISHED = AdjointConfig(drop_smoothing=True, carry_control=True, drop_drag=True)


@dataclass(frozen=True)
class Scheme:
    """Compile-time constants of the kernels of a time step, beside the grid.

    The model is NEO_HOOKEAN or FIXED_COROTATED; atomic scattering adds to one grid, as on a GPU.
    """

    model: int
    atomic: bool
    adjoint: AdjointConfig
