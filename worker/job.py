"""What a job is: plain data, shared by the queue, the child process and the HTTP contract."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field

from chamfer_morph.schemas import Device, ForkOrigin, MeshShape, Problem, Shape
from morph_engine.config import MorphConfig, stored_config
from morph_engine.errors import (
    DiskSpaceError,
    MorphError,
    ResourceError,
    ResultError,
    SimulationError,
)

LESS_MEMORY = (
    "Lower `sampling.points_per_cell_edge`, raise `grid.dx`, or raise MORPH_JOB_MEMORY_BYTES."
)
"""The remedy for a job that takes more memory than jobs may have."""

MORE_DISK = "Free some space on the disk of MORPH_DATA_DIR of the service, then resume the job."
"""The remedy for a job whose result cannot be written."""


class JobSpec(BaseModel, frozen=True, extra="forbid"):
    """Everything that a job needs, fixed when it is submitted."""

    source: Shape
    via: tuple[Shape, ...] = Field(
        (), description="Shapes between them.", exclude_if=lambda via: not via
    )
    target: Shape
    config: Annotated[MorphConfig, BeforeValidator(stored_config)]
    device: Device = "auto"
    timeout_seconds: float = Field(gt=0, description="Running time after which it is stopped [s].")
    states_every: int = Field(0, ge=0, description="Frames between two states kept; 0 for none.")
    fork: ForkOrigin | None = Field(
        None, description="Where its first frames come from, if not computed by itself."
    )

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """All shapes in their order, from the source to the target."""
        return (self.source, *self.via, self.target)

    @property
    def meshes(self) -> list[str]:
        """Digests of the meshes among them."""
        return [shape.mesh for shape in self.shapes if isinstance(shape, MeshShape)]

    @property
    def frame_count(self) -> int:
        """Number of frames of all legs."""
        return self.config.frames * (len(self.via) + 1)


def problem_of(error: MorphError) -> Problem:
    """An error of the engine as the reason why a job, or an export of it, has failed."""
    kind: Literal["simulation", "resources", "input"] = "input"
    if isinstance(error, SimulationError):
        kind = "simulation"
    elif isinstance(error, ResourceError | ResultError):
        kind = "resources"
    # nobody chooses where the result of a job is written
    remedy = MORE_DISK if isinstance(error, DiskSpaceError) else error.remedy
    return Problem(cause=error.cause, remedy=remedy, kind=kind)
