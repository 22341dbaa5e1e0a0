"""A sample of `python -m benchmarks.corruption`: damaged meshes against the real command."""

from __future__ import annotations

import pytest

from benchmarks.corruption import cases, inspect
from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import load_mesh
from morph_engine.ingest import check_mesh


@pytest.mark.parametrize("case", tuple(cases(6, seed=20)), ids=lambda case: case.name)
def test_command_refuses_or_accepts(case, tmp_path):
    """The real process ends with status 0 or 2, in bounded time and memory, without traceback."""
    assert not inspect(case, tmp_path).failure


@pytest.mark.parametrize("case", tuple(cases(80, seed=7)), ids=lambda case: case.name)
def test_reader_raises_nothing_but_mesh_errors(case, tmp_path):
    """Reading and checking a damaged file either works or raises a MeshError with a remedy."""
    path = tmp_path / f"damaged.{case.suffix}"
    path.write_bytes(case.data)
    try:
        check_mesh(load_mesh(path))
    except MeshError as error:
        assert error.cause and error.remedy
