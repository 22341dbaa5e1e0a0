"""Why something cannot be done, in words a user can act on."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field


class Problem(BaseModel):
    """Why a job failed, in words a user can act on."""

    cause: str
    remedy: str = ""
    kind: Literal["input", "resources", "simulation", "crash", "hang", "timeout", "internal"]


class ProblemDocument(BaseModel):
    """An error (RFC 9457, application/problem+json)."""

    type: str = Field(
        "about:blank", description="Stable name of the kind of problem, e.g. /problems/not-found."
    )
    title: str = Field(description="The kind of problem in words.")
    status: int
    detail: str = Field(description="What went wrong.")
    remedy: str = Field("", description="What to do about it.")
    errors: list[dict[str, Any]] = Field(
        default_factory=list, description="Errors in individual fields."
    )
