"""The paper's meshes: which they are, where the public originals come from, and their folder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from morph_engine.errors import MeshError
from morph_engine.files import file_sha256
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.shapes import make

SUFFIX = ".obj"
TOLERANCE = 0.02
"""A mesh stands for the paper's if its bounding box agrees to this share of its size."""

BUILT_IN_PARTICLES = 37_600

_STANFORD = "the Stanford 3D Scanning Repository"
_CRANE = "Keenan Crane's 3D Model Repository"
_LETTERS = "any program that extrudes letters, to the bounds of algorithm 1.5"


@dataclass(frozen=True)
class Asset:
    """A mesh of the paper (algorithm 1.5).

    Attributes:
        origin: Where the public original comes from.
        particle_count: Particles at 3 points per cell edge.
        bounds: Lower and upper corner [dx]; None where the authors' file is not known.
    """

    origin: str
    particle_count: int
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]] | None


ASSETS = {
    "sphere.obj": Asset(
        "an icosahedron subdivided once, radius 7.25, centre (0, 0, -0.625)", 37_644,
        ((-6.8952, -7.25, -7.875), (6.8952, 7.25, 6.625)),
    ),
    "bunny.obj": Asset(
        f"{_STANFORD} (bunny)", 31_428,
        ((-8.105, -7.8421, -7.0628), (5.8329, 10.1412, 10.7628)),
    ),
    "duck.obj": Asset(
        f"{_CRANE} (Bob)", 36_166,
        ((-9.145, -11.4117, -6.391), (9.145, 11.788, 5.7656)),
    ),
    "cow.obj": Asset(
        f"{_CRANE} (Spot)", 25_792,
        ((-5.1871, -8.458, -9.2046), (5.1871, 10.439, 9.3901)),
    ),
    "teapot.obj": Asset("the Utah teapot", 44_497, ((-8.0, -12.0, -5.0), (8.0, 13.736, 7.6))),
    "dragon.obj": Asset(f"{_STANFORD} (dragon), scaled to 26 grid units", 37_000, None),
    "duck_y90.obj": Asset(
        f"{_CRANE} (Bob), turned by 90 degrees about y", 36_173,
        ((-6.391, -11.4117, -9.145), (5.7656, 11.788, 9.145)),
    ),
    "heart.obj": Asset(
        "any heart, to the bounds of algorithm 1.5", 26_576,
        ((-4.1041, -7.9688, -8.9653), (4.1231, 7.9688, 5.9709)),
    ),
    "letter_C.obj": Asset(_LETTERS, 36_243, ((-6.21, -6.8753, -10.436), (6.75, 7.5881, 10.2092))),
    "letter_E.obj": Asset(_LETTERS, 45_491, ((-6.3, -4.5115, -10.443), (6.7, 8.5295, 10.5))),
    "letter_V.obj": Asset(_LETTERS, 50_233, ((-6.3, -9.0592, -11.8192), (6.5, 8.8832, 7.9376))),
}  # fmt: skip


def particle_count(name: str) -> int:
    """Particles of a shape at 3 points per cell edge, about."""
    return ASSETS[name].particle_count if name in ASSETS else BUILT_IN_PARTICLES


class MeshFolder:
    """The folder that holds the paper's meshes under the names in `ASSETS`.

    Args:
        path: The folder, which need not exist where only built-in shapes are used.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def locate(self, name: str) -> str:
        """What the engine is to open for a shape: a file of the folder, or a built-in name."""
        return str(self.path / name) if name.endswith(SUFFIX) else name

    def digest(self, name: str) -> str:
        """SHA-256 of a shape: of the file, or of the arrays of a built-in shape.

        Raises:
            MeshError: There is no such file or shape.
        """
        return _digest(self.locate(name)) if name.endswith(SUFFIX) else make(name).sha256

    def check(self, names: Iterable[str]) -> None:
        """Make sure that the files are there and have the paper's scale.

        Raises:
            MeshError: Some are missing, or one is not where the paper has it.
        """
        wanted = sorted({name for name in names if name.endswith(SUFFIX)})
        missing = [name for name in wanted if not (self.path / name).is_file()]
        if missing:
            origins = "; ".join(
                f"{name}: {ASSETS[name].origin}" for name in missing if name in ASSETS
            )
            raise MeshError(
                f"There is no {', '.join(missing)} in the folder {self.path}.",
                "Name the folder of the meshes with --meshes or MORPH_MESHES; "
                "or use --fetch or morph shapes fetch to make them from their "
                f"public originals ({origins}).",
            )
        for name in wanted:
            if name in ASSETS and (bounds := ASSETS[name].bounds):
                _check_bounds(self.path / name, np.array(bounds))


def _check_bounds(path: Path, wanted: np.ndarray) -> None:
    found = load_mesh(path).bounds
    if np.abs(found - wanted).max() > TOLERANCE * np.ptp(wanted, axis=0).max():
        spans = [
            " to ".join(f"({', '.join(f'{x:.4g}' for x in corner)})" for corner in box)
            for box in (found, wanted)
        ]
        raise MeshError(
            f"{path} spans {spans[0]} and the paper's mesh spans {spans[1]}.",
            "Scale and place it as the paper does; results depend on it.",
        )


@cache
def _digest(path: str) -> str:
    try:
        return file_sha256(Path(path))
    except OSError as error:
        raise MeshError(f"{path} cannot be read ({error.strerror}).", "Check --meshes.") from error
