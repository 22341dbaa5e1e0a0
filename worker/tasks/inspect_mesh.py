"""Look at an uploaded mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from morph_engine.geometry.mesh import load_mesh
from morph_engine.ingest import check_mesh, fitted
from morph_engine.ingest import inspect_mesh as ingest_report


def run(path: Path, name: str) -> dict[str, Any]:
    """The ingest report of a mesh file; its place and size can be mended by a run.

    Args:
        path: The file; its suffix tells the format.
        name: What the user calls it.

    Returns:
        `IngestReport` as JSON.

    Raises:
        MeshError: It is no mesh, or cannot be filled with particles.
    """
    mesh = replace(load_mesh(path), name=name)
    check_mesh(fitted(mesh, "auto")[0], own=mesh)
    report: dict[str, Any] = ingest_report(mesh).model_dump(mode="json")
    return report
