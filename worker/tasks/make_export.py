"""An export of a result, made in a child with little memory and kept beside the job.

The child is this module, run with RESULT FOLDER ORDER; it prints JSON lines: how far it has
come, and what went wrong.
"""

from __future__ import annotations

import contextlib
import errno
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from chamfer_morph.schemas import Problem, Sha256
from chamfer_morph.worker import sandbox
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.job import problem_of
from chamfer_morph.worker.niceness import yield_to_others
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from morph_engine.digest import file_sha256
from morph_engine.errors import MorphError
from morph_engine.files import replacing, wait_for

LESS = "Ask for fewer frames at a time, or run the job with fewer points per cell edge."
FULL = (errno.EFBIG, errno.ENOSPC, errno.EDQUOT)


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

    def remove(self, folder: Path, export_id: str) -> None:
        """Remove it, the document first, so that it is whole as long as it is found."""
        (folder / f"{export_id}.json").unlink(missing_ok=True)
        (folder / self.file).unlink(missing_ok=True)


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
    room: Callable[[], int],
    watch: Callable[[float], None],
    meet: Callable[[subprocess.Popen[bytes]], None],
) -> None:
    """Make an export and keep it; blocks.

    Args:
        storage: Where the result is, and the export will be.
        job_id: The job.
        order: What to export.
        settings: Memory and CPU time that it may take.
        room: Disk that it may fill [bytes], asked for when it begins.
        watch: Called with the share that is done.
        meet: Called with the child.

    Raises:
        ExportFailed: It could not be made.
    """
    limits = sandbox.Limits(
        settings.export_memory_bytes,
        settings.export_cpu_seconds,
        file_bytes=room(),
        threads=sandbox.MOST_THREADS,
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
        with sandbox.explaining("The export", "compute", limits, LESS):
            sandbox.run(__name__, arguments, limits, hear=hear, meet=meet)
    except MorphError as error:
        problems.append(problem_of(error))
    if problems:
        raise ExportFailed(problems[0])


def _main() -> None:
    from morph_engine import export  # noqa: F401  the program's own memory is free

    sandbox.enter()
    yield_to_others()
    result, folder, order = sys.argv[1:]
    try:
        _keep(Path(result), Path(folder), Order.model_validate_json(order))
    except MemoryError:
        sys.exit(ExitCode.OUT_OF_MEMORY)
    except MorphError as error:
        _say(problem=_plain(error, folder, result).model_dump())


def _plain(error: MorphError, *paths: str) -> Problem:
    """Why it has failed, without the places where the service keeps things."""
    if isinstance(error.__cause__, OSError) and error.__cause__.errno in FULL:
        return Problem(
            cause="The export does not fit the disk, or what this key may fill of it.",
            remedy="Delete exports and jobs that are not needed any more.",
            kind="resources",
        )
    problem = problem_of(error)
    cause = problem.cause
    for path in paths:
        cause = cause.replace(f"{path}/", "").replace(path, "the result")
    return problem.model_copy(update={"cause": cause})


def _keep(result: Path, folder: Path, order: Order) -> None:
    from morph_engine.export import export, find, suffix

    with wait_for(folder / "lock"):  # another API may be at it
        if KeptExport.find(folder, order.id) is not None:
            return
        _clear(folder)
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


def _clear(folder: Path) -> None:
    """Remove what exports have left behind that were killed; nobody else is at work here."""
    documents = list(folder.glob("*.json"))
    files = [KeptExport.model_validate_json(text.read_text("utf-8")).file for text in documents]
    kept = {"lock", *files, *(text.name for text in documents)}
    for entry in folder.iterdir():
        if entry.name in kept:
            continue
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)


def _say(**message: Any) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _main()
