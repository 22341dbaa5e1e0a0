"""Uploaded meshes."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field

from chamfer_morph.schemas.types import Sha256


class Mesh(BaseModel):
    """An uploaded mesh."""

    id: Sha256 = Field(description="SHA-256 of the file.")
    name: str
    size_bytes: int
    created_at: datetime
    report: dict[str, Any] = Field(description="Ingest report, as from `morph inspect --json`.")


class MeshPage(BaseModel):
    """Some meshes, the newest first."""

    items: list[Mesh]
    next_cursor: str | None = Field(
        description="Pass as `cursor` for the next page; null at the end."
    )
