"""What a job is: plain data, shared by the queue, the child process and the HTTP contract."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field

from chamfer_morph.schemas import Device, Problem, Shape
from morph_engine.config import MorphConfig, stored_config
from morph_engine.errors import MorphError, ResourceError, ResultError, SimulationError


class JobSpec(BaseModel, frozen=True, extra="forbid"):
    """Everything that a job needs, fixed when it is submitted."""

    source: Shape
    target: Shape
    config: Annotated[MorphConfig, BeforeValidator(stored_config)]
    device: Device = "auto"
    timeout_seconds: float = Field(gt=0, description="Running time after which it is stopped [s].")


def problem_of(error: MorphError) -> Problem:
    """An error of the engine as the reason why a job, or an export of it, has failed."""
    kind: Literal["simulation", "resources", "input"] = "input"
    if isinstance(error, SimulationError):
        kind = "simulation"
    elif isinstance(error, ResourceError | ResultError):
        kind = "resources"
    return Problem(cause=error.cause, remedy=error.remedy, kind=kind)
