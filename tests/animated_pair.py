"""Pairs whose motion is exported as one animated GLB, and the motion as it should be."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from morph_engine.export import export
from morph_engine.results.selection import Selection
from morph_engine.results.tracked_surface import TrackedMesh, TrackedSurface, track_surface
from morph_engine.results.trajectory import Trajectory

MORPH = Path(sys.executable).with_name("morph")
FRAMES = 12
FPS = 10
PAIRS = {"sphere-star": False, "heart-teapot": False, "sphere-torus": True}
"""Whether the mesh has to change, as no mesh is both a ball and a ring."""


@dataclass(frozen=True, eq=False)
class AnimatedPair:
    """A morph of few particles.

    Attributes:
        path: The animated GLB.
        surface: Where its meshes should be [user units].
        changes: Whether the mesh has to change on the way.
    """

    path: Path
    surface: TrackedSurface
    changes: bool

    @classmethod
    def computed(cls, pair: str, folder: Path) -> AnimatedPair:
        """Compute a pair of `PAIRS` and export it, in a folder."""
        result, path = folder / "result.vtkhdf", folder / "morph.glb"
        coarse = ["--frames", str(FRAMES), "--points-per-cell-edge", "1", "--quiet"]
        subprocess.run([MORPH, "run", *pair.split("-"), "--out", result, *coarse], check=True)
        export(result, path, "glb", tracked=True, fps=FPS)
        with Trajectory(result) as trajectory:
            frames = tuple(range(FRAMES))
            surface = track_surface(Selection(trajectory, frames, surface=True, tracked=True))
        return cls(path, surface, PAIRS[pair])

    def shown(self, frame: int) -> TrackedMesh:
        """The mesh that is shown in a frame."""
        return next(mesh for mesh in reversed(self.surface.meshes) if frame in mesh.frames)
