"""Look at an uploaded mesh, in a child process with little memory and time: files can be hostile.

The child is `python -m worker.inspection FILE NAME`; it prints one JSON object.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from morph_engine.errors import MeshError, MorphError, ResourceError
from worker.settings import Settings

_LIMITS = "MORPH_INSPECTION_LIMITS"


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
    environment = os.environ | {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",  # each thread of it reserves memory that the limit counts
        _LIMITS: f"{settings.inspect_memory_bytes} {settings.inspect_cpu_seconds}",
    }
    try:
        ended = subprocess.run(
            [sys.executable, "-m", "worker.inspection", str(path), name],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=2 * settings.inspect_cpu_seconds + 10,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise _too_slow(name, settings) from None
    if ended.returncode == 0:
        answer = json.loads(ended.stdout)
        if "report" in answer:
            report: dict[str, Any] = answer["report"]
            return report
        if answer["error"] is None:
            raise _too_big(name, settings)
        raise MeshError(answer["error"]["cause"], answer["error"]["remedy"])
    killer = -ended.returncode
    if killer in (signal.SIGXCPU, signal.SIGKILL):
        raise _too_slow(name, settings)
    if b"bad_alloc" in ended.stderr or b"MemoryError" in ended.stderr:
        raise _too_big(name, settings)
    how = signal.Signals(killer).name if killer > 0 else f"exit status {ended.returncode}"
    raise MeshError(
        f"{name} breaks the program that reads meshes ({how}).",
        "Export the mesh again, as OBJ, STL or GLB.",
    )


def _too_slow(name: str, settings: Settings) -> ResourceError:
    return ResourceError(
        f"{name} takes more than {settings.inspect_cpu_seconds} s to read.",
        "Decimate the mesh; the simulation sees no detail below half a grid unit.",
    )


def _too_big(name: str, settings: Settings) -> ResourceError:
    return ResourceError(
        f"{name} takes more than {settings.inspect_memory_bytes >> 20} MiB of memory to read.",
        "Decimate the mesh; the simulation sees no detail below half a grid unit.",
    )


def _main() -> None:
    from morph_engine import ingest, sampling  # noqa: F401  the program's own memory is free

    memory, seconds = map(int, os.environ[_LIMITS].split())
    _restrict(memory, seconds)
    path, name = Path(sys.argv[1]), sys.argv[2]
    try:
        answer: dict[str, Any] = {"report": _report(path, name)}
    except MemoryError:
        answer = {"error": None}
    except MorphError as error:
        answer = {
            "error": {
                "cause": error.cause.replace(str(path), name).replace(path.name, name),
                "remedy": error.remedy,
            }
        }
    sys.stdout.write(json.dumps(answer))


def _report(path: Path, name: str) -> dict[str, Any]:
    from morph_engine.ingest import check_mesh, inspect_mesh
    from morph_engine.mesh import load_mesh
    from morph_engine.sampling import fit_to_domain

    mesh = replace(load_mesh(path), name=name)
    check_mesh(fit_to_domain(mesh, mode="volume")[0])  # its place and size can be mended by a run
    return inspect_mesh(mesh).model_dump(mode="json")


def _restrict(memory: int, seconds: int) -> None:
    """Take away what reading a mesh does not need."""
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    if sys.platform != "darwin":  # which does not enforce it
        memory += psutil.Process().memory_info().vms
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


if __name__ == "__main__":
    _main()
