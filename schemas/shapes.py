"""What a job morphs from and to."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from chamfer_morph.schemas.types import Sha256


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
