"""Jobs: what is asked for, and how they stand."""

from __future__ import annotations

from datetime import datetime
from enum import Enum
from typing import Any

from pydantic import BaseModel, Field

from chamfer_morph.schemas.problems import Problem
from chamfer_morph.schemas.shapes import Shape
from chamfer_morph.schemas.types import Device, JobStage, Name, Request, Seed, Sha256


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


class JobOptions(Request):
    """How to compute: what a job and all jobs of a sweep are asked with."""

    preset: str = Field("fast", description="Configuration to start from, see /v1/presets.")
    overrides: dict[str, Any] = Field(
        default_factory=dict, description='Settings by dotted path, e.g. {"chamfer.weight": 5}.'
    )
    frames: int | None = Field(None, ge=1, le=10000, description="Short for the override `frames`.")
    name: Name = Field("", description="For your own use.")
    device: Device = "auto"
    priority: int = Field(100, ge=1, le=1000, description="Smaller runs earlier among your jobs.")
    timeout_seconds: float | None = Field(None, gt=0, description="Stop after so long [s].")
    reuse: bool = Field(
        False,
        description="Succeed at once with the result of a job of yours that has succeeded with the "
        "same shapes, settings and device, by the code in use.",
    )


class JobRequest(JobOptions):
    """A morph to compute."""

    source: Shape = Field(description="Where the particles come from.")
    target: Shape = Field(description="What they are to become.")
    method: str | None = Field(None, description="Short for the override `method`.")
    seed: Seed | None = Field(None, description="Short for the override `seed`.")


class Progress(BaseModel):
    """How far a job has come."""

    frame: int = Field(description="Finished frames.")
    frames: int = Field(description="Frames asked for.")
    attempt: int = Field(description="1 for the first attempt.")
    metrics: dict[str, float] = Field(
        default_factory=dict, description="Of the last finished frame."
    )
    seconds_left: float | None = Field(None, description="Estimate of the time left [s].")
    stage: JobStage | None = Field(
        None,
        description="Before the first frame of an attempt: `filling` the shapes with particles, "
        "`preparing` the method, `computing` the frame. From `preparing` on the source is there.",
    )


class Job(BaseModel):
    """A job as it stands."""

    id: str
    name: str
    state: JobState
    source: Shape
    target: Shape
    source_name: str
    target_name: str
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
    paused: bool = Field(False, description="Whether it waits until its owner ends a pause.")
    outcome: Outcome | None = Field(description="Once it has succeeded.")
    problem: Problem | None = Field(description="Once it has failed or timed out.")


class JobPage(BaseModel):
    """Some jobs, the newest first."""

    items: list[Job]
    next_cursor: str | None
