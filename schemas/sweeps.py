"""Sweeps: many jobs at once."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, Field

from chamfer_morph.schemas.jobs import JobOptions, JobState
from chamfer_morph.schemas.shapes import Shape
from chamfer_morph.schemas.types import Seed


class SweepRequest(JobOptions):
    """Every combination of sources, targets, methods and seeds."""

    sources: list[Shape] = Field(min_length=1, max_length=100)
    targets: list[Shape] = Field(min_length=1, max_length=100)
    methods: list[str] = Field(default=["flow"], min_length=1, max_length=20)
    seeds: list[Seed] = Field(default=[42], min_length=1, max_length=100)


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
