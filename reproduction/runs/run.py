"""One run of the reproduction: what is morphed into what, how, and at which cost."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import BaseModel, Field

from chamfer_morph.reproduction.meshes import MeshFolder, particle_count
from morph_engine.code_digest import code_digest
from morph_engine.config import MorphConfig
from morph_engine.cost import estimate
from morph_engine.presets import configure
from morph_engine.sections import PlacementConfig

CONTROLLED_METHODS = ("physics", "joint")
"""Methods whose matter is controlled by gradients, the only ones with a quick variant: `transport`
needs none, and for methods that move points alone every preset has the same settings."""

PUBLISHED_COST = 2.5
"""Cost of the preset `published` in parts of that which their options state, for `fast`."""


class Run(BaseModel, frozen=True, extra="forbid"):
    """One run. Equal ids are equal runs, whichever tables they serve.

    A name that ends with .obj is a file in the folder of meshes, any other a built-in shape.
    """

    id: str = Field(pattern=r"^[a-z0-9][a-z0-9.-]*$", max_length=100)
    source: str
    target: str
    method: str
    preset: str = "published"
    frames: int = Field(40, ge=1)
    seed: int = 42
    points_per_cell_edge: int = Field(3, ge=1, le=8)
    overrides: dict[str, Any] = Field(default_factory=dict, description="Settings by dotted path.")

    @property
    def shapes(self) -> tuple[str, str]:
        """Names of source and target."""
        return self.source, self.target

    @property
    def settings(self) -> dict[str, Any]:
        """What is replaced in the preset, by dotted path."""
        return {
            "method": self.method,
            "frames": self.frames,
            "seed": self.seed,
            "sampling.points_per_cell_edge": self.points_per_cell_edge,
            "sampling.fit": "none",  # the paper's meshes are as large as it took them
            **self.overrides,
        }

    def config(self) -> MorphConfig:
        """The resolved configuration.

        Raises:
            ConfigError: There is no such preset or setting, or a value is out of range.
        """
        return configure(self.preset, self.settings)

    def digest(self, meshes: MeshFolder) -> str:
        """SHA-256 of everything that determines the result: configuration and both shapes.

        The preset's name is left out, and so is a placement that asks for nothing.

        Raises:
            MorphError: A mesh is missing, or as `config`.
        """
        config = self.config()
        left_out = {"preset"}
        if config.placement == PlacementConfig():
            left_out.add("placement")
        inputs = {
            "config": config.model_dump(mode="json", exclude=left_out),
            "shapes": [meshes.digest(name) for name in self.shapes],
        }
        return digest(inputs)

    @property
    def code(self) -> str:
        """SHA-256 of the code that shapes the result, see `code_digest`.

        Raises:
            ConfigError: There is no such method.
        """
        return code_digest(self.method)

    def quick(self) -> Run:
        """The same with the preset `fast`, where that changes anything."""
        if self.method not in CONTROLLED_METHODS or self.preset != "published":
            return self
        return self.model_copy(update={"id": f"{self.id}-quick", "preset": "fast"})

    @property
    def expected_cpu_seconds(self) -> float:
        """What the run costs about [CPU s], by the rates of its method."""
        source, target = (
            particle_count(name) * self.points_per_cell_edge**3 // 27 for name in self.shapes
        )
        seconds = estimate(source, target, self.frames, method=self.method, threads=1).seconds
        is_slow = self.method in CONTROLLED_METHODS and self.preset == "published"
        return PUBLISHED_COST * seconds if is_slow else seconds


def digest(inputs: Any) -> str:
    """SHA-256 of JSON data, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
