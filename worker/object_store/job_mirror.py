"""A job's folder on this machine, and the same files in the object store.

A worker claims a job, which brings the folder up to the store, and then publishes what its engine
writes. Everybody else fetches.
"""

from __future__ import annotations

import os
import secrets
import shutil
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePosixPath

from pydantic import BaseModel, ValidationError

from chamfer_morph.worker.object_store.bucket import PART_BYTES, Bucket, ObjectChangedError
from chamfer_morph.worker.object_store.manifest import Manifest, Piece
from chamfer_morph.worker.storage import OwnershipLostError, RemoteFile, StoreUnavailableError
from morph_engine.files import wait_for

STATE, LOCK = ".mirror.json", ".mirror.lock"

GROWING = ("events.jsonl", "log.txt")
"""Files that only grow: what is new of them is a piece more."""

NOT_PUBLISHED = ("derived", "lock", STATE, LOCK)
"""What each machine has of its own."""

ROUNDS = 8
"""How often what changes while it is read is read again."""


class _Copy(BaseModel):
    """A file of the folder that equals, or begins like, one in the store.

    Attributes:
        pieces: Pieces that it has.
        stamp: Time of its last change [ns] and its size [bytes] when it had no more than them.
    """

    pieces: list[Piece]
    stamp: tuple[int, int]


class _State(BaseModel):
    """What this machine knows of the store.

    Attributes:
        etag: ETag of the manifest when it was last read; None where there was none.
        manifest: The manifest.
        copies: Files of the folder that have come from the store, or gone to it.
    """

    etag: str | None = None
    manifest: Manifest = Manifest()
    copies: dict[str, _Copy] = {}


class JobMirror:
    """The two copies of a job's files. Calls block, and wait for each other.

    Args:
        bucket: The store.
        job_id: The job.
        folder: Its folder on this machine, which need not exist yet.

    Attributes:
        folder: The same.
    """

    def __init__(self, bucket: Bucket, job_id: str, folder: Path) -> None:
        self._bucket = bucket
        self._prefix = f"jobs/{job_id}"
        self.folder: Path = folder
        self._writer = ""
        self._sent: dict[str, _Copy] = {}  # what the manifest does not name yet
        self._loose: set[str] = set()  # keys that it may not name
        self._busy = threading.RLock()

    def fetch(self, *, log_only: bool = False) -> None:
        """Bring the folder up to the store; files that others than this have put there stay.

        Args:
            log_only: Whether only the files that grow are wanted.

        Raises:
            StoreUnavailableError: The store does not answer.
            OSError: The disk refuses.
        """
        with self._busy:
            for _ in range(ROUNDS):
                with suppress(FileNotFoundError):  # an object has gone meanwhile: look again
                    self._fetch(log_only)
                    return
            raise _restless()

    def remote_file(self, name: str) -> RemoteFile | None:
        """A file in the store, to be read without fetching it; None where it is here, or nowhere.

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        state = self._state()
        try:
            found = self._bucket.get_unless(self._manifest_key, state.etag)
        except FileNotFoundError:
            return None
        manifest = Manifest.model_validate_json(found[0]) if found else state.manifest
        pieces, copy = manifest.files.get(name), state.copies.get(name)
        here = copy and copy.pieces == pieces and copy.stamp == _stamp_or_none(self.folder / name)
        if not pieces or here:
            return None
        return RemoteFile(sum(piece.size for piece in pieces), partial(self._read, pieces))

    def claim(self, wait_seconds: float) -> None:
        """Become the one who publishes the job; the folder has then all that was published.

        What this machine was the last to publish stays as it is, with what has come since. What
        others have sent and not published goes.

        Args:
            wait_seconds: How long to wait for an engine that is just ending here [s].

        Raises:
            TimeoutError: An engine still works here.
            OwnershipLostError: Others claim it all the time.
            StoreUnavailableError: The store does not answer.
            OSError: The disk refuses.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        with self._busy, wait_for(self.folder / "lock", wait_seconds):
            for _ in range(ROUNDS):
                before = self._state().etag
                self.fetch()
                state = self._state()
                if state.etag is None or state.etag != before:
                    for name in self._names() - state.manifest.files.keys():
                        (self.folder / name).unlink()
                self._writer = secrets.token_hex(8)
                run = state.manifest.run or secrets.token_hex(8)
                manifest = Manifest(writer=self._writer, run=run, files=state.manifest.files)
                sent = {key.rpartition("/")[2] for key in self._bucket.keys(self._files)}
                with suppress(ObjectChangedError):
                    self._replace(state.etag, manifest, state.copies)
                    self._loose = sent  # nobody can name any more of it
                    self._delete_loose(manifest)
                    return
            raise OwnershipLostError(self._prefix)

    def publish(self) -> None:
        """Let the store have what is new in the folder, if anything is.

        Raises:
            OwnershipLostError: Another worker has claimed the job meanwhile.
            StoreUnavailableError: The store does not answer; to be called again.
            OSError: The disk refuses.
        """
        with self._busy:
            for _ in range(ROUNDS):
                with suppress(FileNotFoundError):  # a file has gone while the folder was read
                    self._publish()
                    return
            raise _restless()

    def size(self) -> int:
        """Size of what the store has of the job [bytes].

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        try:
            return Manifest.model_validate_json(self._bucket.get(self._manifest_key)).size
        except FileNotFoundError:
            return 0

    def discard(self) -> None:
        """Delete what the job has left, here and in the store; whoever works on it is fenced out.

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        with self._busy:
            keys = self._bucket.keys(self._files)
            with suppress(FileNotFoundError):
                self._bucket.delete([self._manifest_key])
            self._bucket.delete(keys)
            self._clear()

    def remove_folder(self) -> None:
        """Delete what this machine has of the job."""
        with self._busy:
            shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def _manifest_key(self) -> str:
        return f"{self._prefix}/manifest.json"

    @property
    def _files(self) -> str:
        return f"{self._prefix}/files/"

    def _key(self, piece: Piece) -> str:
        return f"{self._files}{piece.key}"

    def _publish(self) -> None:
        """Publish what is new.

        The order in which files are read matters, since the engine goes on meanwhile: an event
        tells of a frame that is there, a checkpoint follows its frames, and a result is whole
        before the run directory goes.
        """
        state = self._state()
        names = self._names()
        copies: dict[str, _Copy] = {}
        for name in sorted(names, key=_reading_order):
            known, stamp = state.copies.get(name), _stamp(self.folder / name)
            if known is None or known.stamp != stamp:
                known = self._send(name, stamp, known.pieces if known else [])
            copies[name] = known
        if names - self._names():
            raise FileNotFoundError  # the run directory became a result meanwhile
        files = {name: copy.pieces for name, copy in copies.items()}
        manifest = Manifest(writer=self._writer, run=state.manifest.run, files=files)
        if files != state.manifest.files:
            try:
                self._replace(state.etag, manifest, copies)
            except ObjectChangedError:
                self._delete_unnamed()
                raise OwnershipLostError(self._prefix) from None
            self._loose |= state.manifest.keys
        self._delete_loose(manifest)

    def _send(self, name: str, stamp: tuple[int, int], published: list[Piece]) -> _Copy:
        """Write a file, or what it has grown by, into objects; goes on where it has broken off."""
        sent, size = self._sent.get(name), stamp[1]
        if sent is None or sent.stamp != stamp:
            grows = name in GROWING and sum(piece.size for piece in published) <= size
            sent = self._sent[name] = _Copy(pieces=[*published] if grows else [], stamp=stamp)
        begin = sum(piece.size for piece in sent.pieces)
        with (self.folder / name).open("rb") as file:
            file.seek(begin)
            while data := file.read(min(PART_BYTES, size - begin)):
                piece = Piece(key=secrets.token_hex(8), size=len(data))
                self._loose.add(piece.key)
                self._bucket.put(self._key(piece), data)
                sent.pieces.append(piece)
                begin += len(data)
        return sent

    def _delete_loose(self, manifest: Manifest) -> None:
        """Delete what was sent and is not in the manifest of this writer."""
        self._bucket.delete(f"{self._files}{key}" for key in self._loose - manifest.keys)
        self._loose.clear()
        self._sent.clear()

    def _delete_unnamed(self) -> None:
        """Delete what was sent in vain: no manifest to come can name what the present one does not.

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        try:
            present = Manifest.model_validate_json(self._bucket.get(self._manifest_key))
        except FileNotFoundError:  # the job has been deleted
            present = Manifest()
        self._delete_loose(present)

    def _replace(self, etag: str | None, manifest: Manifest, copies: dict[str, _Copy]) -> None:
        """Replace the manifest that has this ETag.

        Raises:
            ObjectChangedError: Somebody else has replaced it.
        """
        data = manifest.model_dump_json().encode()
        try:
            new = self._bucket.replace(self._manifest_key, data, etag)
        except ObjectChangedError:  # by ourselves, if only the answer was lost
            try:
                found = self._bucket.get_unless(self._manifest_key, None)
            except FileNotFoundError:
                found = None
            if found is None or found[0] != data:
                raise
            new = found[1]
        self._save(_State(etag=new, manifest=manifest, copies=copies))

    def _fetch(self, log_only: bool) -> None:
        """Bring the folder up to the last manifest.

        Raises:
            FileNotFoundError: An object has gone: the manifest is not the last one any more.
        """
        state = self._state()
        try:
            found = self._bucket.get_unless(self._manifest_key, state.etag)
        except FileNotFoundError:
            if state.etag is not None:
                self._clear()
            return
        manifest = Manifest.model_validate_json(found[0]) if found else state.manifest
        etag = found[1] if found else state.etag
        wanted = [name for name in manifest.files if name in GROWING or not log_only]
        if not found and all(name in state.copies for name in wanted):
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        with wait_for(self.folder / LOCK):  # other processes of this machine fetch, too
            state = self._state()
            if state.manifest.run != manifest.run:
                self._clear()
                state = _State()
            for name in sorted(wanted, key=_fetching_order):
                self._download(name, manifest.files[name], state.copies)
            for name in state.copies.keys() - manifest.files.keys():
                (self.folder / name).unlink(missing_ok=True)
                del state.copies[name]
            self._save(_State(etag=etag, manifest=manifest, copies=state.copies))

    def _download(self, name: str, pieces: list[Piece], copies: dict[str, _Copy]) -> None:
        """Bring a file up to its pieces."""
        path, copy = self.folder / name, copies.get(name)
        known = copy.pieces if copy and copy.stamp == _stamp_or_none(path) else []
        if known and known == pieces:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        if known and known == pieces[: len(known)]:
            new = b"".join(self._parts(pieces[len(known) :]))
            with path.open("ab") as file:
                file.write(new)
        else:
            temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}.tmp")
            try:
                with temporary.open("wb") as file:
                    file.writelines(self._parts(pieces))
                os.replace(temporary, path)
            finally:
                temporary.unlink(missing_ok=True)
        copies[name] = _Copy(pieces=pieces, stamp=_stamp(path))

    def _parts(self, pieces: list[Piece]) -> Iterator[bytes]:
        """What pieces hold, part by part."""
        return self._read(pieces, 0, sum(piece.size for piece in pieces))

    def _read(self, pieces: list[Piece], begin: int, end: int) -> Iterator[bytes]:
        """The same from one place in the file to another."""
        for piece in pieces:
            if begin < piece.size and end > 0:
                first, last = max(begin, 0), min(end, piece.size)
                yield from self._bucket.parts(self._key(piece), last, first)
            begin, end = begin - piece.size, end - piece.size

    def _names(self) -> set[str]:
        """Files that are to be published, by their paths in the folder."""
        names = set()
        for folder, _, files in os.walk(self.folder):
            for file in files:
                name = (Path(folder) / file).relative_to(self.folder).as_posix()
                parts = PurePosixPath(name).parts
                own = parts[0] in NOT_PUBLISHED or parts[-1] == "lock"
                if not own and not name.endswith(".tmp"):
                    names.add(name)
        return names

    def _clear(self) -> None:
        """Empty the folder, but for locks that somebody may hold."""
        for path in [*self.folder.iterdir()] if self.folder.is_dir() else []:
            if path.name in ("lock", LOCK):
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)

    def _state(self) -> _State:
        try:
            return _State.model_validate_json((self.folder / STATE).read_bytes())
        except (FileNotFoundError, ValidationError):
            return _State()

    def _save(self, state: _State) -> None:
        temporary = self.folder / f"{STATE}.{secrets.token_hex(4)}.tmp"
        temporary.write_text(state.model_dump_json(), encoding="utf-8")
        os.replace(temporary, self.folder / STATE)


def _restless() -> StoreUnavailableError:
    return StoreUnavailableError(
        f"The job's files changed {ROUNDS} times while they were read.", "Try again soon."
    )


def _reading_order(name: str) -> tuple[int, str]:
    """Events before the frames that they tell of, a checkpoint before the frames it follows."""
    if name in GROWING:
        return 0, name
    return (1, name) if "checkpoint" in name else (2, name)


def _fetching_order(name: str) -> tuple[bool, str]:
    return name in GROWING, name


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size


def _stamp_or_none(path: Path) -> tuple[int, int] | None:
    try:
        return _stamp(path)
    except FileNotFoundError:
        return None
