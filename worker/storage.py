"""The data directory: meshes by the digest of their file, one directory per job, locks.

Hosts share it, or each has its own and an object store keeps what they have in common: then the
methods that say so bring the directory and the store together, see `object_store/`.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from chamfer_morph.schemas import MeshShape, Shape
from chamfer_morph.worker.event_log import EventLog
from chamfer_morph.worker.settings import Settings
from morph_engine.errors import ConfigError, MeshError, MorphError, ResultError
from morph_engine.files import replacing, sync_directory, wait_for

PROBE_BYTES = 1 << 17

RESULT = "result.vtkhdf"
"""Name of the result in the folder of its job."""

DISCARD = "discard-"

REMOVALS = 10
"""How often a folder is removed that somebody still writes into."""
"""How a file begins that marks the rest of its folder to be deleted."""


class StoreUnavailableError(MorphError):
    """The object store does not answer, or answers with an error."""


@dataclass(frozen=True)
class RemoteFile:
    """A file that another host has published and this one does not have.

    Attributes:
        size: Its size [bytes].
        read: Yields its bytes from one place to another, part by part; it raises
            StoreUnavailableError, and FileNotFoundError where the file has gone.
    """

    size: int
    read: Callable[[int, int], Iterator[bytes]]


class OwnershipLostError(Exception):
    """Another worker has claimed the job, or its files were discarded: this one has to stop."""


def open_storage(settings: Settings, process: str) -> Storage:
    """The files of the service, as a process sees them.

    Args:
        settings: Where they are.
        process: Name of the process, which has a folder of that name where an object store is used.

    Raises:
        ConfigError: The address of the object store cannot be used.
        ExtraError: What it needs is not installed.
    """
    if not settings.object_store:
        return Storage(settings.data_dir)
    from chamfer_morph.worker.object_store.bucket import Bucket
    from chamfer_morph.worker.object_store.shared_storage import SharedStorage

    # of all processes: by what they leave there a probe sees that they live
    (settings.data_dir / "locks").mkdir(parents=True, exist_ok=True)
    return SharedStorage(
        settings.data_dir / process,
        settings.data_dir / "uploads",
        Bucket.open(settings.object_store),
        settings.object_store_cache_bytes,
    )


class Storage:
    """Files of the service; every method may be called from any process.

    Args:
        root: The data directory, created where missing.

    Raises:
        ConfigError: It cannot be created.
    """

    def __init__(self, root: Path) -> None:
        self.root: Path = root.absolute()
        try:
            if not self.root.exists():
                self.root.mkdir(parents=True, exist_ok=True)
                self.root.chmod(0o700)  # of whoever runs the service alone
            for name in ("meshes", "uploads", "jobs", "locks"):
                (self.root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"The data directory {self.root} cannot be used ({error.strerror or error}).",
                "Name a folder that the service may write to in MORPH_DATA_DIR, or make this one "
                "writable.",
            ) from error

    @property
    def uploads(self) -> Path:
        """Directory of uploads in progress."""
        return self.root / "uploads"

    @property
    def kept_results(self) -> Path:
        """Directory of what the engine keeps for later jobs; it may be deleted at any time."""
        return self.root / "cache"

    def probe(self) -> None:
        """See whether there is room for the few blocks that a small request takes.

        Raises:
            OSError: The disk is full, or refuses otherwise.
        """
        path = self.uploads / f".probe-{secrets.token_hex(8)}"
        try:
            path.write_bytes(bytes(PROBE_BYTES))
        finally:
            path.unlink(missing_ok=True)

    def probe_store(self) -> None:
        """See whether the object store answers, where there is one.

        Raises:
            StoreUnavailableError: It does not.
        """

    def add_mesh(self, temporary: Path, sha256: str, suffix: str, report: dict[str, Any]) -> None:
        """Move an uploaded file to its place; the mesh exists once its report does."""
        folder = self._mesh_folder(sha256)
        folder.mkdir(exist_ok=True)
        os.replace(temporary, folder / f"mesh.{suffix}")
        with replacing(folder / "report.json") as path:
            path.write_text(json.dumps({"report": report}), encoding="utf-8")
        sync_directory(folder.parent)

    def mesh_file(self, sha256: str) -> Path | None:
        """The file of a mesh, or None where there is none, or its report cannot be read."""
        if self.mesh_report(sha256) is None:
            return None
        return next(self._mesh_folder(sha256).glob("mesh.*"), None)

    def mesh_report(self, sha256: str) -> dict[str, Any] | None:
        """The ingest report of a mesh, or None where there is none that can be read."""
        try:
            text = (self._mesh_folder(sha256) / "report.json").read_text(encoding="utf-8")
            report = json.loads(text)["report"]
        except (OSError, ValueError, LookupError, TypeError):
            return None
        return report if isinstance(report, dict) else None

    def remove_mesh(self, sha256: str) -> None:
        """Delete a mesh, if it is there."""
        folder = self._mesh_folder(sha256)
        (folder / "report.json").unlink(missing_ok=True)
        shutil.rmtree(folder, ignore_errors=True)

    def resolve(self, shape: Shape) -> str:
        """What the engine takes for a shape: a mesh file, or the name of a built-in one.

        Raises:
            MeshError: The mesh has been deleted.
        """
        if not isinstance(shape, MeshShape):
            return shape.shape
        file = self.mesh_file(shape.mesh)
        if file is None:
            raise MeshError(f"The mesh {shape.mesh} has been deleted.", "Upload it again.")
        return str(file)

    def fetch(self, job_id: str, settled: object = None, *, log_only: bool = False) -> None:
        """See to it that the directory of a job has what other hosts have published.

        Args:
            job_id: The job.
            settled: Tells what a finished job is from what it was before; None while it runs.
            log_only: Whether only its events and messages are wanted.

        Raises:
            StoreUnavailableError: The object store does not answer.
        """

    def remote_result(self, job_id: str) -> RemoteFile | None:
        """The result file of a job, where other hosts have it and this one does not.

        Raises:
            StoreUnavailableError: The object store does not answer.
        """
        return None

    def claim(self, job_id: str, wait_seconds: float) -> None:
        """Take the files of a job over from whoever worked on it last, who cannot publish any more.

        Args:
            job_id: The job.
            wait_seconds: How long to wait for an engine that is just ending [s].

        Raises:
            OwnershipLostError: Others take it over all the time.
            StoreUnavailableError: The object store does not answer.
        """
        self.job_dir(job_id).mkdir(exist_ok=True)

    def publish(self, job_id: str) -> None:
        """Let other hosts have what is new in the directory of a job that was claimed.

        Raises:
            OwnershipLostError: Another worker has claimed it.
            StoreUnavailableError: The object store does not answer; to be called again.
        """

    def release(self, job_id: str) -> None:
        """Have done with a job: all of it is published."""

    def job_dir(self, job_id: str) -> Path:
        """The directory of a job; it need not exist yet."""
        return self.root / "jobs" / job_id

    def result_path(self, job_id: str) -> Path:
        """The result file of a job; its run directory lies beside it while it runs."""
        return self.job_dir(job_id) / RESULT

    def states_dir(self, job_id: str) -> Path:
        """Where states of a job after some of its frames are kept; it need not be there."""
        return self.job_dir(job_id) / "states"

    def state_path(self, job_id: str, frame: int) -> Path:
        """The state of a job after a frame; it need not be there."""
        return self.states_dir(job_id) / f"{frame:06d}.npz"

    def derived_dir(self, job_id: str) -> Path:
        """Where what is computed from a job's frames on request is kept, and goes with the job."""
        return self.job_dir(job_id) / "derived"

    def make_derived_dirs(self, job_id: str) -> None:
        """Make the folders for it.

        Raises:
            ResultError: The job has been deleted.
        """
        try:
            self.derived_dir(job_id).mkdir(exist_ok=True)
            self.exports_dir(job_id).mkdir(exist_ok=True)
        except FileNotFoundError:
            raise ResultError(
                "The job has been deleted in the meantime.", "Submit it again."
            ) from None

    def surface_path(self, job_id: str, frame: int) -> Path:
        """The surface of a frame, with its snapped corners; it need not be there."""
        return self.derived_dir(job_id) / f"surfaces-{frame:06d}.npz"

    def exports_dir(self, job_id: str) -> Path:
        """Where the exports of a job are kept."""
        return self.derived_dir(job_id) / "exports"

    def events(self, job_id: str) -> EventLog:
        """The event log of a job."""
        return _event_log(self, job_id)

    def job_bytes(self, job_id: str) -> int:
        """Disk that a job fills [bytes]."""
        return folder_bytes(self.job_dir(job_id))

    def mark_for_discard(self, job_id: str) -> str:
        """Mark what a job has left, to be deleted before it is computed again.

        Returns:
            The name of the mark, another one for each call.
        """
        folder = self.job_dir(job_id)
        folder.mkdir(exist_ok=True)
        mark = f"{DISCARD}{secrets.token_hex(8)}"
        (folder / mark).touch()
        return mark

    def unmark(self, job_id: str, mark: str | None = None) -> None:
        """Take back a mark, or all those of who died before the job was in the queue."""
        with suppress(FileNotFoundError):  # the job is being deleted
            for path in self.job_dir(job_id).glob(mark or f"{DISCARD}*"):
                path.unlink(missing_ok=True)

    def discard_if_marked(self, job_id: str, *, wait_seconds: float) -> None:
        """Delete what a job has left, if that is marked and no engine works on it.

        Args:
            job_id: The job.
            wait_seconds: How long to wait for an engine that is just ending [s].
        """
        folder = self.job_dir(job_id)
        if not any(folder.glob(f"{DISCARD}*")):
            return
        with suppress(TimeoutError), wait_for(folder / "lock", wait_seconds):
            marks = [*folder.glob(f"{DISCARD}*")]
            if not marks:  # a worker has begun meanwhile
                return
            for path in folder.iterdir():
                if path.name == "lock" or path in marks:
                    continue
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
            for mark in marks:  # last, so that what is broken off is done again
                mark.unlink(missing_ok=True)

    def remove_job(self, job_id: str) -> None:
        """Delete what a job left, if anything; an engine that is just ending may still write."""
        folder = self.job_dir(job_id)
        for _ in range(REMOVALS):
            shutil.rmtree(folder, ignore_errors=True)
            if not folder.exists():
                return

    def _mesh_folder(self, sha256: str) -> Path:
        return self.root / "meshes" / sha256


def folder_bytes(root: Path) -> int:
    """Disk that the files below a folder fill [bytes]."""
    total = 0
    for folder, _, files in os.walk(root):
        for name in files:
            with suppress(FileNotFoundError):
                total += os.stat(os.path.join(folder, name)).st_size
    return total


@contextmanager
def writing(subject: str) -> Iterator[None]:
    """Tell a user what could not be written.

    Args:
        subject: What is written, as the beginning of a sentence: "The surface".

    Raises:
        ResultError: The disk refuses, or a folder has gone.
    """
    try:
        yield
    except TimeoutError:  # of a lock: an OSError, too
        raise
    except OSError as error:
        raise ResultError(
            f"{subject} cannot be written to ({error.strerror or error}).",
            "Free some disk space, and check that the job has not been deleted.",
        ) from error


@lru_cache(maxsize=4096)
def _event_log(storage: Storage, job_id: str) -> EventLog:
    """The event log of a job; to put its path together takes longer than to look at the file."""
    return EventLog(storage.job_dir(job_id) / "events.jsonl")
