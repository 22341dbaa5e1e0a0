"""An export of a result, made in a child with little memory and kept beside the job.

The child is `python -m worker.exporting RESULT FOLDER ORDER`; it prints JSON lines: how far it has
come, and what went wrong.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from morph_engine.digest import file_sha256
from morph_engine.durable import acquire, replacing
from morph_engine.errors import MorphError, ResourceError, ResultError
from worker import limited
from worker.job import Problem, Sha256
from worker.priority import yield_to_others
from worker.settings import Settings
from worker.storage import Storage

LOCK_SECONDS = 0.1


class Order(BaseModel):
    """What to export.

    Attributes:
        id: Tells this export from others of the job.
        name: What to call the file elsewhere, without its ending.
        format: As `morph_engine.export.export` takes it, and so are the others.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    name: str
    format: str
    frames: list[int] | None
    surface: bool
    units: Literal["user", "grid"]
    fields: list[str]


class KeptExport(BaseModel):
    """An export as it lies on the disk.

    Attributes:
        file: Name of its file, beside this document.
        name: What to call the file elsewhere.
        media_type: Its media type.
        size_bytes: Its size.
        sha256: Its digest.
    """

    file: str
    name: str
    media_type: str
    size_bytes: int
    sha256: Sha256

    @classmethod
    def find(cls, folder: Path, export_id: str) -> KeptExport | None:
        """One that is whole, or None."""
        try:
            text = (folder / f"{export_id}.json").read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        return cls.model_validate_json(text)


class ExportFailed(Exception):
    """An export could not be made.

    Attributes:
        problem: Why.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.cause)
        self.problem = problem


def make_export(
    storage: Storage,
    job_id: str,
    order: Order,
    settings: Settings,
    room: int,
    watch: Callable[[float], None],
    meet: Callable[[subprocess.Popen[bytes]], None],
) -> None:
    """Make an export and keep it; blocks.

    Args:
        storage: Where the result is, and the export will be.
        job_id: The job.
        order: What to export.
        settings: Memory and CPU time that it may take.
        room: Disk that it may fill [bytes].
        watch: Called with the share that is done.
        meet: Called with the child.

    Raises:
        ExportFailed: It could not be made.
    """
    limits = limited.Limits(
        settings.export_memory_bytes,
        settings.export_cpu_seconds,
        file_bytes=room,
        threads=limited.MOST_THREADS,
    )
    problems: list[Problem] = []

    def hear(line: bytes) -> None:
        with contextlib.suppress(ValueError, TypeError, KeyError):  # anything else that was printed
            said: dict[str, Any] = json.loads(line)
            if "problem" in said:
                problems.append(Problem.model_validate(said["problem"]))
            else:
                watch(float(said["progress"]))

    result, folder = storage.result_path(job_id), storage.exports_dir(job_id)
    arguments = [str(result), str(folder), order.model_dump_json()]
    try:
        storage.make_derived_dirs(job_id)
        with limited.explaining("The export", limits):
            limited.run("worker.exporting", arguments, limits, hear=hear, meet=meet)
    except MorphError as error:
        problems.append(_problem(error))
    if problems:
        raise ExportFailed(problems[0])


def _problem(error: MorphError) -> Problem:
    kind: Literal["resources", "input"] = (
        "resources" if isinstance(error, ResourceError | ResultError) else "input"
    )
    return Problem(cause=error.cause, remedy=error.remedy, kind=kind)


def _main() -> None:
    from morph_engine import export  # noqa: F401  the program's own memory is free

    limited.enter()
    yield_to_others()
    result, folder, order = sys.argv[1:]
    try:
        _keep(Path(result), Path(folder), Order.model_validate_json(order))
    except MemoryError:
        sys.exit(limited.OUT_OF_MEMORY)
    except MorphError as error:
        _say(problem=_problem(error).model_dump())


def _keep(result: Path, folder: Path, order: Order) -> None:
    from morph_engine.export import export, find, suffix

    while (lock := acquire(folder / "lock")) is None:  # another API may be at it
        time.sleep(LOCK_SECONDS)
    with lock:
        if KeptExport.find(folder, order.id) is not None:
            return
        ending = suffix(order.format, order.frames)
        path = folder / f"{order.id}{ending}"
        export(
            result,
            path,
            order.format,
            frames=order.frames,
            surface=order.surface,
            units=order.units,
            fields=order.fields,
            watch=lambda done, total: _say(progress=done / max(total, 1)),
        )
        media_type = "application/zip" if ending == ".zip" else find(order.format).media_type
        kept = KeptExport(
            file=path.name,
            name=f"{order.name}{ending}",
            media_type=media_type,
            size_bytes=path.stat().st_size,
            sha256=file_sha256(path),
        )
        with replacing(folder / f"{order.id}.json") as temporary:
            temporary.write_text(kept.model_dump_json(), encoding="utf-8")


def _say(**message: Any) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _main()
