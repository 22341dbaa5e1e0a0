"""What a job morphs from and to."""

from __future__ import annotations

from pydantic import BaseModel, Field

from chamfer_morph.schemas.types import Sha256


class MeshShape(BaseModel, frozen=True, extra="forbid"):
    """An uploaded mesh."""

    mesh: Sha256 = Field(description="Id of an uploaded mesh, the SHA-256 of its file.")


class BuiltInShape(BaseModel, frozen=True, extra="forbid"):
    """A shape that needs no file."""

    shape: str = Field(
        min_length=1,
        max_length=65,
        description="Name of a built-in shape, or text: and up to 60 characters.",
    )


Shape = MeshShape | BuiltInShape
