"""Jobs: what is asked for, and how they stand."""

from __future__ import annotations

from datetime import datetime
from enum import Enum
from typing import Annotated, Any

from pydantic import BaseModel, Field

from chamfer_morph.schemas.problems import Problem
from chamfer_morph.schemas.shapes import Shape
from chamfer_morph.schemas.types import Device, JobStage, Name, Request, Seed, Sha256, Up

MOST_STOPS = 32
"""Of shapes between source and target."""


class JobState(str, Enum):
    """The state of a job."""

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


class Outcome(BaseModel):
    """The outcome of a succeeded job."""

    sha256: Sha256 = Field(description="SHA-256 of result.vtkhdf.")
    size_bytes: int
    frames: int
    metrics: dict[str, float] = Field(description="Metrics of the last frame.")
    particle_count: int
    target_count: int
    cpu_seconds: float = Field(description="CPU time of the last attempt [s].")
    peak_memory_mb: float = Field(description="Largest resident memory of the last attempt [MB].")
    provenance: dict[str, Any] = Field(
        default_factory=dict,
        description="Code, machine, time and cost of the last attempt. It names no code if the "
        "frames were computed by several versions of the code.",
    )


StatesEvery = Annotated[int, Field(ge=0, le=10000)]
STATES_EVERY = (
    "Keep the full state after every N frames, from which a fork can start; 0 for none. "
    "A state takes about 100 bytes per particle."
)


class JobOptions(Request):
    """How to compute: options of a job, or of all jobs of a sweep."""

    preset: str = Field("fast", description="Configuration to start from, see /v1/presets.")
    overrides: dict[str, Any] = Field(
        default_factory=dict, description='Settings by dotted path, e.g. {"chamfer.weight": 5}.'
    )
    frames: int | None = Field(
        None,
        ge=1,
        le=10000,
        description="Short for the override `frames`, the number for each leg.",
    )
    name: Name = Field("", description="A name of your choice.")
    device: Device = "auto"
    priority: int = Field(
        100, ge=1, le=1000, description="Among your jobs, lower numbers start first."
    )
    timeout_seconds: float | None = Field(
        None, gt=0, description="Stop the job after this running time [s]."
    )
    reuse: bool = Field(
        False,
        description="Succeed at once with the result of a job of yours that has succeeded with the "
        "same shapes, settings, device and code. With `states_every` the job is computed all the "
        "same, since the other may have kept no states.",
    )
    states_every: StatesEvery = Field(0, description=STATES_EVERY)


class JobRequest(JobOptions):
    """A morph to compute."""

    source: Shape = Field(description="The shape to start from.")
    via: list[Shape] = Field(
        [],
        max_length=MOST_STOPS,
        description="Shapes to pass through, in this order. The way to each is a leg of `frames` "
        "frames, which starts where the previous one ended.",
        exclude_if=lambda via: not via,
    )
    target: Shape = Field(description="The shape to morph into.")
    method: str | None = Field(None, description="Short for the override `method`.")
    seed: Seed | None = Field(None, description="Short for the override `seed`.")


class ForkRequest(Request):
    """A job that continues from a frame of another with other settings."""

    frame: int | None = Field(
        None,
        ge=0,
        description="Index of the last frame to keep; default: the last one with a full state.",
    )
    overrides: dict[str, Any] = Field(
        default_factory=dict, description="Settings to change, by dotted path."
    )
    name: Name = Field("", description="A name of your choice.")
    priority: int = Field(
        100, ge=1, le=1000, description="Among your jobs, lower numbers start first."
    )
    timeout_seconds: float | None = Field(
        None, gt=0, description="Stop the job after this running time [s]."
    )
    states_every: StatesEvery = Field(0, description=STATES_EVERY)


class ForkOrigin(BaseModel, frozen=True):
    """Where the first frames of a job come from."""

    job: str
    frame: int = Field(description="Index of the last frame that both jobs have in common.")


class Progress(BaseModel):
    """How far a job has come."""

    frame: int = Field(description="Finished frames.")
    frames: int = Field(description="Frames requested, over all legs.")
    attempt: int = Field(description="1 for the first attempt.")
    metrics: dict[str, float] = Field(
        default_factory=dict, description="Metrics of the last finished frame."
    )
    seconds_left: float | None = Field(None, description="Estimated time left [s].")
    stage: JobStage | None = Field(
        None,
        description="Before the first frame of an attempt or a leg: `filling` the shapes with "
        "particles, `preparing` the method, `computing` the frame. The source is "
        "available from `preparing` on.",
    )


Matrix = list[list[float]]


class JobPlacement(BaseModel):
    """How a job places its shapes."""

    up: Up = Field(description="The axis of the grid that points upwards.")
    source: Matrix = Field(
        description="Matrix from the source's coordinates to grid units, 4 x 4; acts on column "
        "vectors."
    )
    target: Matrix = Field(description="Likewise for the target.")


class Job(BaseModel):
    """A job and its current state."""

    id: str
    name: str
    state: JobState
    source: Shape
    via: list[Shape] = Field([], description="Shapes between source and target.")
    target: Shape
    source_name: str
    via_names: list[str] = []
    target_name: str
    placement: JobPlacement | None = Field(
        None, description="How its shapes are placed; null for jobs of older versions."
    )
    method: str
    preset: str
    seed: int
    device: Device
    priority: int
    sweep: str | None
    owner: str = Field(description="Name of the key that submitted it; empty without keys.")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    progress: Progress
    queue_position: int | None = Field(
        description="Jobs to be started before it; null if it is not queued or is paused."
    )
    forked_from: ForkOrigin | None = Field(None, description="For forks, where it started.")
    reused_from: str | None = Field(
        None, description="The job that computed its result, if another one did."
    )
    paused: bool = Field(
        False, description="Whether it is waiting because its owner has paused the queue."
    )
    outcome: Outcome | None = Field(description="Set once it has succeeded.")
    problem: Problem | None = Field(description="Set once it has failed or timed out.")


class JobPage(BaseModel):
    """Some jobs, the newest first."""

    items: list[Job]
    next_cursor: str | None
