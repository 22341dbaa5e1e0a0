"""What every test shares: the paper's meshes, and a device in the precision a test asks for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MESHES = Path(os.environ.get("MORPH_MESHES", ROOT.parent / "shared" / "meshes"))


@pytest.fixture
def paper_mesh() -> Callable[[str], Path]:
    """Path of one of the paper's meshes; skips where they are absent."""

    def find(name: str) -> Path:
        path = MESHES / f"{name}.obj"
        if not path.exists():
            pytest.skip(f"{path} is absent; set MORPH_MESHES to the folder of the paper's meshes")
        return path

    return find


@pytest.fixture
def float64_device() -> None:
    """The CPU in float64, for comparisons with exact mathematics."""
    from morph_engine import backend

    backend.start("cpu", precision="float64")


@pytest.fixture
def float32_device() -> None:
    """The CPU in float32, as in production."""
    from morph_engine import backend

    backend.start("cpu")
