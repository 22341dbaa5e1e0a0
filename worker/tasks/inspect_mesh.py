"""Look at an uploaded mesh, in a child process with little memory and time: files can be hostile.

The child is this module, run with FILE NAME; it prints one JSON object.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from chamfer_morph.worker import sandbox
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.settings import Settings
from morph_engine.errors import MeshError, MorphError


def inspect_file(path: Path, name: str, settings: Settings) -> dict[str, Any]:
    """The ingest report of a mesh file that can be used, as it is or scaled to the domain.

    Args:
        path: The file; its suffix tells the format.
        name: What the user calls it.
        settings: Memory and CPU time that it may take.

    Returns:
        `IngestReport` as JSON.

    Raises:
        MeshError: The file is no mesh, cannot be filled with particles, or breaks the reader.
        ResourceError: It takes too much memory or time to read.
    """
    answer = json.loads(read_mesh(__name__, [str(path), name], name, settings))
    if "report" in answer:
        report: dict[str, Any] = answer["report"]
        return report
    raise MeshError(answer["error"]["cause"], answer["error"]["remedy"])


def read_mesh(module: str, arguments: Sequence[str], name: str, settings: Settings) -> bytes:
    """What a child prints that reads a mesh file.

    Raises:
        MeshError: The file breaks the reader.
        ResourceError: It takes too much memory or time to read.
    """
    limits = sandbox.Limits(settings.inspect_memory_bytes, settings.inspect_cpu_seconds)
    remedy = "Decimate the mesh; the simulation sees no detail below half a grid unit."
    with sandbox.explaining(name, "read", limits, remedy):
        try:
            return sandbox.run(module, arguments, limits)
        except sandbox.Broken as how:
            raise MeshError(
                f"{name} breaks the program that reads meshes ({how}).",
                "Export the mesh again, as OBJ, STL or GLB.",
            ) from None


def refusal(error: MorphError, path: Path, name: str) -> dict[str, dict[str, str]]:
    """An error as a child prints it, in which the file has the user's name for it."""
    cause = error.cause.replace(str(path), name).replace(path.name, name)
    return {"error": {"cause": cause, "remedy": error.remedy}}


def _main() -> None:
    from morph_engine.geometry import ingest, sampling  # noqa: F401  the program's own memory is free

    sandbox.enter()
    path, name = Path(sys.argv[1]), sys.argv[2]
    try:
        answer: dict[str, Any] = {"report": _report(path, name)}
    except MemoryError:
        sys.exit(ExitCode.OUT_OF_MEMORY)
    except MorphError as error:
        answer = refusal(error, path, name)
    sys.stdout.write(json.dumps(answer))


def _report(path: Path, name: str) -> dict[str, Any]:
    from morph_engine.geometry.ingest import check_mesh, inspect_mesh
    from morph_engine.geometry.mesh import load_mesh
    from morph_engine.geometry.sampling import fit_to_domain

    mesh = replace(load_mesh(path), name=name)
    check_mesh(fit_to_domain(mesh, mode="volume")[0])  # its place and size can be mended by a run
    return inspect_mesh(mesh).model_dump(mode="json")


if __name__ == "__main__":
    _main()
