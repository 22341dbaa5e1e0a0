"""What there is to choose from."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field


class Resource(BaseModel):
    """A preset, method or built-in shape."""

    name: str
    description: str
    config: dict[str, Any] | None = Field(None, description="For presets: all settings, resolved.")


class ParticleField(BaseModel):
    """A number for each particle, to colour particles by."""

    name: str
    label: str
    unit: str = Field(description="dx (grid units), h (lattice spacings), ratio or count.")
    meaning: str
    diverging: bool = Field(
        description="Whether 1 is neutral, with meaning in values on both sides."
    )


class ExportFormat(BaseModel):
    """A format to export to."""

    name: str
    suffix: str = Field(description="File extension, with the dot.")
    media_type: str
    kind: Literal["frame", "sequence", "table"] = Field(
        description="One frame per file, all frames in one file, or numbers without geometry."
    )
    carries: list[
        Literal["points", "surface", "fields", "tracked", "texture", "picture", "transparency"]
    ] = Field(
        description="What its files can hold; `picture` if it is rendered, `transparency` if its "
        "background may be transparent."
    )
    timed: bool = Field(
        False,
        description="Whether its playing time can be chosen; for kind `frame` only with a tracked "
        "surface.",
    )
    extra: str | None = Field(description="Extra of the package that it requires on the service.")
    description: str
