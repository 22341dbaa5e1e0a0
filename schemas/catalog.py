"""What there is to choose from."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field


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


class ExportFormat(BaseModel):
    """A format to export to."""

    name: str
    suffix: str = Field(description="Ending of its files, with the dot.")
    media_type: str
    kind: Literal["frame", "sequence", "table"] = Field(
        description="One frame a file, all in one, or numbers without geometry."
    )
    carries: list[
        Literal["points", "surface", "fields", "tracked", "texture", "picture", "transparency"]
    ] = Field(
        description="What its files can hold; `picture` where it is drawn, `transparency` where "
        "its background may be transparent."
    )
    timed: bool = Field(
        False,
        description="Whether it may be played in a time of its own; of kind `frame` only as a "
        "tracked surface.",
    )
    extra: str | None = Field(description="Extra of the package that the service must have for it.")
    description: str
