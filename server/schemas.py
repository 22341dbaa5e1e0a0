"""The HTTP contract as plain data, all that the client knows of the server."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from worker.job import (
    BuiltInShape,
    Fit,
    JobState,
    MeshShape,
    Outcome,
    Problem,
    Sha256,
    Shape,
)

Device = Literal["auto", "cpu", "cuda", "vulkan", "metal"]
Scope = Literal["read", "submit", "admin"]
FrameFormat = Literal["f32", "u16", "ply", "npy"]
SurfaceFormat = Literal["glb", "ply", "obj", "stl"]
Units = Literal["grid", "user"]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Name = Annotated[str, Field(max_length=200, pattern=r"^[^\x00]*$")]


class Request(BaseModel):
    """Base of request bodies: unknown fields and other types are errors."""

    model_config = ConfigDict(extra="forbid", strict=True)


class ProblemDocument(BaseModel):
    """An error (RFC 9457, application/problem+json)."""

    type: str = Field(
        "about:blank", description="Stable name of the kind of problem, e.g. /problems/not-found."
    )
    title: str = Field(description="The kind of problem in words.")
    status: int
    detail: str = Field(description="What is wrong here.")
    remedy: str = Field("", description="What to do about it.")
    errors: list[dict[str, Any]] = Field(
        default_factory=list, description="Faults of single fields."
    )


class Mesh(BaseModel):
    """An uploaded mesh."""

    id: Sha256 = Field(description="SHA-256 of the file.")
    name: str
    size_bytes: int
    created_at: datetime
    report: dict[str, Any] = Field(description="Ingest report, as of `morph inspect --json`.")


class MeshPage(BaseModel):
    """Some meshes, the newest first."""

    items: list[Mesh]
    next_cursor: str | None = Field(
        description="Pass as `cursor` for the next page; null at the end."
    )


class JobRequest(Request):
    """A morph to compute."""

    source: Shape = Field(description="Where the particles come from.")
    target: Shape = Field(description="What they are to become.")
    preset: str = Field("fast", description="Configuration to start from, see /v1/presets.")
    overrides: dict[str, Any] = Field(
        default_factory=dict, description='Settings by dotted path, e.g. {"chamfer.weight": 5}.'
    )
    method: str | None = Field(None, description="Short for the override `method`.")
    frames: int | None = Field(None, ge=1, le=10000, description="Short for the override `frames`.")
    seed: Seed | None = Field(None, description="Short for the override `seed`.")
    name: Name = Field("", description="For your own use.")
    device: Device = "auto"
    priority: int = Field(100, ge=1, le=1000, description="Smaller runs earlier among your jobs.")
    timeout_seconds: float | None = Field(None, gt=0, description="Stop after so long [s].")


class Progress(BaseModel):
    """How far a job has come."""

    frame: int = Field(description="Finished frames.")
    frames: int = Field(description="Frames asked for.")
    attempt: int = Field(description="1 for the first attempt.")
    metrics: dict[str, float] = Field(
        default_factory=dict, description="Of the last finished frame."
    )
    seconds_left: float | None = Field(None, description="Estimate of the time left [s].")


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
        description="Jobs to be started before it; null unless queued."
    )
    outcome: Outcome | None = Field(description="Once it has succeeded.")
    problem: Problem | None = Field(description="Once it has failed or timed out.")


class JobPage(BaseModel):
    """Some jobs, the newest first."""

    items: list[Job]
    next_cursor: str | None


class Event(BaseModel):
    """Something that happened to a job; the same over SSE and by polling."""

    id: int = Field(description="Ascending within a job; resume after it.")
    type: Literal["attempt", "frame", "watchdog", "problem", "state"]
    at: datetime
    data: dict[str, Any]


class EventPage(BaseModel):
    """Events after a given id, the oldest first."""

    items: list[Event]
    last_id: int = Field(description="Pass as `after` next time.")
    state: JobState


class SweepRequest(Request):
    """Every combination of sources, targets, methods and seeds."""

    sources: list[Shape] = Field(min_length=1, max_length=100)
    targets: list[Shape] = Field(min_length=1, max_length=100)
    methods: list[str] = Field(default=["transport"], min_length=1, max_length=20)
    seeds: list[Seed] = Field(default=[42], min_length=1, max_length=100)
    preset: str = "fast"
    overrides: dict[str, Any] = Field(default_factory=dict)
    frames: int | None = Field(None, ge=1, le=10000)
    name: Name = ""
    device: Device = "auto"
    priority: int = Field(100, ge=1, le=1000)
    timeout_seconds: float | None = Field(None, gt=0)


class SweepRow(BaseModel):
    """One job of a sweep."""

    job: str
    source: str
    target: str
    method: str
    seed: int
    state: JobState
    metrics: dict[str, float]


class Sweep(BaseModel):
    """A sweep and its combined table."""

    id: str
    name: str
    created_at: datetime
    counts: dict[JobState, int]
    rows: list[SweepRow]


class KeyRequest(Request):
    """A new API key."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")
    scopes: list[Scope] = Field(default=["read", "submit"], min_length=1)


class Key(BaseModel):
    """An API key without its secret."""

    name: str
    scopes: list[Scope]
    created_at: datetime


class NewKey(Key):
    """A key with its secret, shown this once."""

    secret: str


class WorkerStatus(BaseModel):
    """A worker slot."""

    id: str = Field(description="host-slotN")
    alive: bool
    paused: bool
    job: str | None = Field(description="What it computes now.")


class Resource(BaseModel):
    """A preset, method or built-in shape."""

    name: str
    description: str
    config: dict[str, Any] | None = Field(None, description="Of a preset: all settings, resolved.")


class ParticleField(BaseModel):
    """A number for each particle, to colour it by."""

    name: str
    label: str
    unit: str = Field(description="dx (grid units), h (lattice spacings), ratio or count.")
    meaning: str
    diverging: bool = Field(description="Whether 1 is neutral, with a meaning on either side.")


class ExportRequest(Request):
    """Frames to write in another format."""

    format: str = Field(max_length=40, description="Name of a format, see /v1/exports/formats.")
    frames: list[int] | None = Field(
        None, min_length=1, max_length=10000, description="0-based, negative from the end; or all."
    )
    surface: bool = Field(False, description="A surface around the particles in their place.")
    units: Units = Field("user", description="The coordinates of the target's file, or grid units.")
    fields: list[str] = Field(
        default_factory=list, max_length=20, description="To carry along, see /v1/fields."
    )


class Export(BaseModel):
    """An export of a job."""

    id: str
    job: str
    state: Literal["running", "ready", "failed"]
    progress: float = Field(description="Share that is done, 0 to 1.")
    problem: Problem | None = Field(description="Once it has failed.")
    file_name: str | None = Field(description="Once it is ready.")
    size: int | None = Field(description="Once it is ready [bytes].")
    links: dict[str, str] = Field(description="`self`, and `file` once it is ready.")


class ExportFormat(BaseModel):
    """A format to export to."""

    name: str
    suffix: str = Field(description="Ending of its files, with the dot.")
    media_type: str
    kind: Literal["frame", "sequence", "table"] = Field(
        description="One frame a file, all in one, or numbers without geometry."
    )
    carries: list[Literal["points", "surface", "fields"]]
    extra: str | None = Field(description="Extra of the package that the service must have for it.")
    description: str


__all__ = [
    "BuiltInShape", "Device", "Event", "EventPage", "Export", "ExportFormat", "ExportRequest",
    "Fit", "FrameFormat", "Job", "JobPage", "JobRequest", "JobState", "Key", "KeyRequest", "Mesh",
    "MeshPage", "MeshShape", "NewKey", "Outcome", "ParticleField", "Problem", "ProblemDocument",
    "Progress", "Resource", "Scope", "Shape", "SurfaceFormat", "Sweep", "SweepRequest", "SweepRow",
    "Units", "WorkerStatus",
]  # fmt: skip
