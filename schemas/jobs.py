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
    """Where a job stands."""

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
    """What a succeeded job left behind."""

    sha256: Sha256 = Field(description="Digest of result.vtkhdf.")
    size_bytes: int
    frames: int
    metrics: dict[str, float] = Field(description="Metrics of the last frame.")
    particle_count: int
    target_count: int
    cpu_seconds: float = Field(description="CPU time of the last attempt [s].")
    peak_memory_mb: float = Field(description="Largest resident memory of the last attempt [MB].")
    provenance: dict[str, Any] = Field(
        default_factory=dict,
        description="By which code, where, when and at which cost the last attempt computed. It "
        "names no code if attempts by several codes made the frames.",
    )


StatesEvery = Annotated[int, Field(ge=0, le=10000)]
STATES_EVERY = (
    "Keep the full state after every so many frames, with which a fork can begin; 0 for none. One "
    "takes some 100 bytes for each particle."
)


class JobOptions(Request):
    """How to compute: what a job and all jobs of a sweep are asked with."""

    preset: str = Field("fast", description="Configuration to start from, see /v1/presets.")
    overrides: dict[str, Any] = Field(
        default_factory=dict, description='Settings by dotted path, e.g. {"chamfer.weight": 5}.'
    )
    frames: int | None = Field(
        None, ge=1, le=10000, description="Short for the override `frames`; of each leg."
    )
    name: Name = Field("", description="For your own use.")
    device: Device = "auto"
    priority: int = Field(100, ge=1, le=1000, description="Smaller runs earlier among your jobs.")
    timeout_seconds: float | None = Field(None, gt=0, description="Stop after so long [s].")
    reuse: bool = Field(
        False,
        description="Succeed at once with the result of a job of yours that has succeeded with the "
        "same shapes, settings and device, by the code in use.",
    )
    states_every: StatesEvery = Field(0, description=STATES_EVERY)


class JobRequest(JobOptions):
    """A morph to compute."""

    source: Shape = Field(description="Where the particles come from.")
    via: list[Shape] = Field(
        [],
        max_length=MOST_STOPS,
        description="Shapes that they become on the way, in this order. The way to each is a leg "
        "of `frames` frames, which begins as the last one has ended.",
        exclude_if=lambda via: not via,
    )
    target: Shape = Field(description="What they are to become.")
    method: str | None = Field(None, description="Short for the override `method`.")
    seed: Seed | None = Field(None, description="Short for the override `seed`.")


class ForkRequest(Request):
    """A job that goes on from a frame of another with other settings."""

    frame: int | None = Field(
        None,
        ge=0,
        description="Index of the last frame that both have in common; by default the last one "
        "after which there is a full state.",
    )
    overrides: dict[str, Any] = Field(
        default_factory=dict, description="Settings by dotted path, in place of the job's."
    )
    name: Name = Field("", description="For your own use.")
    priority: int = Field(100, ge=1, le=1000, description="Smaller runs earlier among your jobs.")
    timeout_seconds: float | None = Field(None, gt=0, description="Stop after so long [s].")
    states_every: StatesEvery = Field(0, description=STATES_EVERY)


class ForkOrigin(BaseModel, frozen=True):
    """Where the first frames of a job come from."""

    job: str
    frame: int = Field(description="Index of the last frame that both jobs have in common.")


class Progress(BaseModel):
    """How far a job has come."""

    frame: int = Field(description="Finished frames.")
    frames: int = Field(description="Frames asked for, of all legs.")
    attempt: int = Field(description="1 for the first attempt.")
    metrics: dict[str, float] = Field(
        default_factory=dict, description="Of the last finished frame."
    )
    seconds_left: float | None = Field(None, description="Estimate of the time left [s].")
    stage: JobStage | None = Field(
        None,
        description="Before the first frame of an attempt or a leg: `filling` the shapes with "
        "particles, `preparing` the method, `computing` the frame. From `preparing` on the source "
        "is there.",
    )


Matrix = list[list[float]]


class JobPlacement(BaseModel):
    """Where a job puts its shapes."""

    up: Up = Field(description="The axis of the grid that points upwards.")
    source: Matrix = Field(
        description="The source's coordinates to grid units, 4 x 4; acts on columns."
    )
    target: Matrix = Field(description="Likewise the target's.")


class Job(BaseModel):
    """A job as it stands."""

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
        None, description="Where it puts them; null for jobs of older versions."
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
        description="Jobs to be started before it; null unless queued, and while paused."
    )
    forked_from: ForkOrigin | None = Field(None, description="Of a fork, where it began.")
    reused_from: str | None = Field(
        None, description="The job that has computed its result, if it has not itself."
    )
    paused: bool = Field(False, description="Whether it waits until its owner ends a pause.")
    outcome: Outcome | None = Field(description="Once it has succeeded.")
    problem: Problem | None = Field(description="Once it has failed or timed out.")


class JobPage(BaseModel):
    """Some jobs, the newest first."""

    items: list[Job]
    next_cursor: str | None
