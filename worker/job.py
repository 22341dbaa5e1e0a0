"""What a job is: plain data, shared by the queue, the child process and the HTTP contract."""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from morph_engine.errors import MorphError, ResourceError, ResultError, SimulationError

Fit = Literal["auto", "none", "volume", "extent"]
"""How a shape is placed in the domain; `auto` scales only what does not fit."""

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class JobState(str, Enum):
    """Where a job stands; `worker.state` has the transitions."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"
    TIMED_OUT = "timed_out"

    @property
    def finished(self) -> bool:
        """Whether the job rests until somebody retries or resumes it."""
        return self not in (JobState.QUEUED, JobState.RUNNING)


class MeshShape(BaseModel):
    """An uploaded mesh."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mesh: Sha256 = Field(description="Id of an uploaded mesh, the SHA-256 of its file.")


class BuiltInShape(BaseModel):
    """A shape that needs no file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    shape: str = Field(
        min_length=1, max_length=64, description="Name of a built-in shape, or text:WORD."
    )


Shape = MeshShape | BuiltInShape


class JobSpec(BaseModel):
    """Everything that a job needs, fixed when it is submitted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    source: Shape
    target: Shape
    config: dict[str, Any] = Field(description="The resolved MorphConfig.")
    device: Literal["auto", "cpu", "cuda", "vulkan", "metal"] = "auto"
    timeout_seconds: float = Field(gt=0, description="Running time after which it is stopped [s].")


class Problem(BaseModel):
    """Why a job failed, in words a user can act on."""

    cause: str
    remedy: str = ""
    kind: Literal["input", "resources", "simulation", "crash", "hang", "timeout", "internal"]


def problem_of(error: MorphError) -> Problem:
    """An error of the engine as the reason why a job, or an export of it, failed."""
    kind: Literal["simulation", "resources", "input"] = "input"
    if isinstance(error, SimulationError):
        kind = "simulation"
    elif isinstance(error, ResourceError | ResultError):
        kind = "resources"
    return Problem(cause=error.cause, remedy=error.remedy, kind=kind)


class Outcome(BaseModel):
    """What a succeeded job left behind."""

    sha256: Sha256 = Field(description="Digest of result.vtkhdf.")
    size_bytes: int
    frames: int
    metrics: dict[str, float] = Field(description="Metrics of the last frame.")
    particle_count: int
    target_count: int
    cpu_seconds: float = Field(description="CPU time of the last attempt [s].")
    peak_memory_mb: float = Field(description="Largest resident memory of the last attempt [MB].")
