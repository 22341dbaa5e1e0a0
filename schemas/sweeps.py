"""Sweeps: many jobs at once."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field

from chamfer_morph.schemas.jobs import JobState
from chamfer_morph.schemas.shapes import Shape
from chamfer_morph.schemas.types import Device, Name, Request, Seed


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
