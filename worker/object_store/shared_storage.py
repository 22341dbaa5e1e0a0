"""Storage whose files every host finds in an object store; its folder is a copy of some of them."""

from __future__ import annotations

import os
import secrets
import shutil
import threading
import time
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any

from chamfer_morph.worker.object_store.bucket import Bucket
from chamfer_morph.worker.object_store.job_mirror import JobMirror
from chamfer_morph.worker.storage import RemoteFile, Storage, folder_bytes
from morph_engine.files import replacing

FRESH_SECONDS = 0.3
"""How long what was fetched of a job that runs is new enough for who only looks."""

EVICTION_SECONDS = 60.0
"""How often it is seen whether copies take too much disk."""

UNUSED_SECONDS = 600.0
"""A copy that was asked for since may be read at this moment."""

MIRRORS_KEPT = 4096


class SharedStorage(Storage):
    """Files of the service in an object store.

    Meshes lie below `meshes/` by the digest of their file, jobs below `jobs/`, each with its
    manifest. Nothing in the folder is needed: a host that loses it fetches it again.

    Args:
        root: Folder of this process for what it has fetched or not published yet.
        uploads: Folder of this host for uploads in progress.
        bucket: The object store.
        cache_bytes: Disk for copies that have not been asked for lately [bytes].
    """

    def __init__(self, root: Path, uploads: Path, bucket: Bucket, cache_bytes: int) -> None:
        super().__init__(root)
        self._cache_bytes = cache_bytes
        self._looked_at = time.monotonic()
        self._uploads = uploads.absolute()
        self._uploads.mkdir(parents=True, exist_ok=True)
        self._bucket = bucket
        self._mirrors: OrderedDict[str, JobMirror] = OrderedDict()
        self._fetched: OrderedDict[tuple[str, bool], tuple[float, object]] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def uploads(self) -> Path:
        """Directory of uploads in progress, of all processes of this host."""
        return self._uploads

    def probe_store(self) -> None:
        """As of `Storage`."""
        self._bucket.keys("probe/")

    def add_mesh(self, temporary: Path, sha256: str, suffix: str, report: dict[str, Any]) -> None:
        """As of `Storage`, in the object store first."""
        self._bucket.put_file(f"meshes/{sha256}/mesh.{suffix}", temporary)
        super().add_mesh(temporary, sha256, suffix, report)
        document = (self._mesh_folder(sha256) / "report.json").read_bytes()
        self._bucket.put(f"meshes/{sha256}/report.json", document)

    def mesh_report(self, sha256: str) -> dict[str, Any] | None:
        """As of `Storage`; a mesh that is not here yet is fetched."""
        self._note_use(self._mesh_folder(sha256))
        return super().mesh_report(sha256) or self._fetch_mesh(sha256)

    def remove_mesh(self, sha256: str) -> None:
        """As of `Storage`; copies on other hosts stay, and are not looked at."""
        keys = self._bucket.keys(f"meshes/{sha256}/")
        self._bucket.delete(sorted(keys, reverse=True))
        super().remove_mesh(sha256)

    def fetch(self, job_id: str, settled: object = None, *, log_only: bool = False) -> None:
        """As of `Storage`."""
        with self._lock:
            at, known = self._fetched.get((job_id, log_only), (float("-inf"), None))
        if settled == known and (settled is not None or time.monotonic() - at < FRESH_SECONDS):
            return
        begun = time.monotonic()
        self._mirror(job_id).fetch(log_only=log_only)
        self._note_use(self.job_dir(job_id))
        with self._lock:
            for part in {True, log_only}:  # the log is a part of everything
                self._fetched[job_id, part] = begun, settled
            while len(self._fetched) > 2 * MIRRORS_KEPT:
                self._fetched.popitem(last=False)

    def remote_result(self, job_id: str) -> RemoteFile | None:
        """As of `Storage`."""
        return self._mirror(job_id).remote_file(self.result_path(job_id).name)

    def claim(self, job_id: str, wait_seconds: float) -> None:
        """As of `Storage`."""
        self._mirror(job_id).claim(wait_seconds)

    def publish(self, job_id: str) -> None:
        """As of `Storage`."""
        self._mirror(job_id).publish()

    def release(self, job_id: str) -> None:
        """As of `Storage`."""
        self._mirror(job_id).remove_folder()

    def job_bytes(self, job_id: str) -> int:
        """Size of what the object store has of a job [bytes]."""
        return self._mirror(job_id).size()

    def mark_for_discard(self, job_id: str) -> str:
        """As of `Storage`."""
        mark = f"{self._marks(job_id)}{secrets.token_hex(8)}"
        self._bucket.put(mark, b"")
        return mark

    def unmark(self, job_id: str, mark: str | None = None) -> None:
        """As of `Storage`."""
        self._bucket.delete([mark] if mark else self._bucket.keys(self._marks(job_id)))

    def discard_if_marked(self, job_id: str, *, wait_seconds: float) -> None:
        """As of `Storage`; an engine that still works on it cannot publish any more."""
        if marks := self._bucket.keys(self._marks(job_id)):
            self._mirror(job_id).discard()
            self._bucket.delete(marks)

    def remove_job(self, job_id: str) -> None:
        """As of `Storage`."""
        self._mirror(job_id).discard()
        self._bucket.delete(self._bucket.keys(self._marks(job_id)))
        super().remove_job(job_id)

    def _mirror(self, job_id: str) -> JobMirror:
        with self._lock:
            mirror = self._mirrors.setdefault(
                job_id, JobMirror(self._bucket, job_id, self.job_dir(job_id))
            )
            self._mirrors.move_to_end(job_id)
            while len(self._mirrors) > MIRRORS_KEPT:
                self._mirrors.popitem(last=False)
        return mirror

    def _note_use(self, folder: Path) -> None:
        """Note that a copy is in use; delete others now and then, where they take too much."""
        with suppress(FileNotFoundError):
            os.utime(folder)
        with self._lock:
            if time.monotonic() - self._looked_at < EVICTION_SECONDS:
                return
            self._looked_at = time.monotonic()
        threading.Thread(target=self.evict, daemon=True).start()  # nobody waits for it

    def evict(self, unused_seconds: float = UNUSED_SECONDS) -> None:
        """Delete the copies that were asked for longest ago, beyond the disk that copies may fill.

        Args:
            unused_seconds: Copies that were asked for since stay [s].
        """
        folders = [
            (folder.stat().st_mtime, folder)
            for kind in ("jobs", "meshes")
            for folder in (self.root / kind).iterdir()
        ]
        kept = 0
        for used_at, folder in sorted(folders, reverse=True):
            kept += folder_bytes(folder)
            if kept > self._cache_bytes and time.time() - used_at >= unused_seconds:
                shutil.rmtree(folder, ignore_errors=True)
                with self._lock:
                    self._fetched.clear()

    def _fetch_mesh(self, sha256: str) -> dict[str, Any] | None:
        """Fetch a mesh; its report last, with which it is there."""
        prefix = f"meshes/{sha256}/"
        sizes = self._bucket.sizes(prefix)
        if f"{prefix}report.json" not in sizes:
            return None
        folder = self._mesh_folder(sha256)
        folder.mkdir(exist_ok=True)
        for key in sorted(sizes):  # mesh.*, report.json
            with replacing(folder / key.removeprefix(prefix)) as path, path.open("wb") as file:
                file.writelines(self._bucket.parts(key, sizes[key]))
        return super().mesh_report(sha256)

    def _marks(self, job_id: str) -> str:
        return f"jobs/{job_id}/discard/"
