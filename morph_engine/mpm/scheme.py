"""What a time step's kernels are compiled for."""

from dataclasses import dataclass


@dataclass(frozen=True)
class AdjointFlags:
    """Three departures of the published program from the exact adjoint (algorithm 4.6).

    Attributes:
        drop_smoothing: Leave (1 - s) out of the path from F to C.
        carry_control: Add s F_bar' to the control gradient.
        drop_drag: Leave the drag out of the derivative of the weights.
    """

    drop_smoothing: bool = False
    carry_control: bool = False
    drop_drag: bool = False


EXACT = AdjointFlags()
PUBLISHED = AdjointFlags(drop_smoothing=True, carry_control=True, drop_drag=True)


@dataclass(frozen=True)
class Scheme:
    """Compile-time constants of the kernels of a time step, beside the grid.

    Attributes:
        model: NEO_HOOKEAN or FIXED_COROTATED.
        atomic: Whether scattering adds atomically to one grid, as on a GPU.
        adjoint: Which adjoint to use.
    """

    model: int
    atomic: bool
    adjoint: AdjointFlags
