"""Back up the service while it works, and restore it elsewhere.

Files are copied, then the database is dumped, then files are copied again. So whatever the database
knows has its files: what was there before the dump and deleted after it is in the first copy, and
what was finished meanwhile in the second. Files of jobs that the database does not know do no harm.
A job that was running goes on, after the last frame that was copied.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ValidationError
from sqlalchemy.exc import DBAPIError

from chamfer_morph.schemas import JobState
from chamfer_morph.server.backup.database_dump import dump, has_tables, load
from chamfer_morph.server.backup.folder_copy import FolderCopy, folder_size
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import RESULT, Storage
from morph_engine.errors import ConfigError
from morph_engine.files import file_sha256, replacing

FOLDERS = ("meshes", "jobs")
"""Of the data directory; the others hold what is in progress, and what can be made again."""

SKIPPED = frozenset({"derived", "lock"})
"""Of a job: what is computed on request, and the lock of its engine."""

RECORD, DATABASE = "backup.json", "database.dump"

NAMES_SHOWN = 20
"""Damaged files that are named."""


class BackupRecord(BaseModel):
    """What a backup has; written last, so that one without it is not complete.

    Attributes:
        format: Version of the backup's layout.
        version: Version of the service that made it.
        database: What was dumped.
        database_sha256: Digest of the dump; None in backups of before there was one.
        finished_at: When it was complete.
        files: Number of files, the database not included.
        bytes: Their size.
        digests: SHA-256 of meshes and of results, by their paths in the backup, as the service
            knows them; none in backups of before there were any.
    """

    format: Literal[1] = 1
    version: str
    database: Literal["sqlite", "postgres"]
    database_sha256: str | None = None
    finished_at: datetime
    files: int
    bytes: int
    digests: dict[str, str] = {}


def back_up(settings: Settings, folder: Path, on_copied: Callable[[int], None]) -> BackupRecord:
    """Copy everything that the service cannot compute again into a folder.

    A folder that has an earlier backup, or an unfinished one, is brought up to date.

    Args:
        settings: Which service; it may be at work.
        folder: Created where missing, for its owner alone.
        on_copied: Called with the size of each file that was copied [bytes].

    Raises:
        ConfigError: The folder has other files, or there is no service.
        MorphError: The database cannot be dumped.
        OSError: A file cannot be read, or the disk refuses.
    """
    unfinished = f"{DATABASE}.tmp", f"{RECORD}.tmp"  # where a backup was killed
    if folder.is_dir() and set(_names(folder)) - {RECORD, DATABASE, *unfinished, *FOLDERS}:
        raise ConfigError(
            f"{folder} contains files that do not belong to a backup.",
            "Name a new or empty folder.",
        )
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    (folder / RECORD).unlink(missing_ok=True)
    copies = []
    if not settings.object_store:
        copies = [
            FolderCopy(settings.data_dir / name, folder / name, SKIPPED, on_copied)
            for name in FOLDERS
        ]
    for copy in copies:
        copy.update()
    dump(settings, folder / DATABASE)
    results = _results(settings) if copies else {}
    for copy in copies:
        copy.update()
        copy.remove_others()
    if results:  # without those that were computed again meanwhile
        results = dict(results.items() & _results(settings).items())
    files, size = _size(folder)
    record = BackupRecord(
        version=metadata.version("chamfer-morph"),
        database=_kind(settings),
        database_sha256=file_sha256(folder / DATABASE),
        finished_at=datetime.now(timezone.utc),
        files=files,
        bytes=size,
        digests=results | _meshes(folder),
    )
    with replacing(folder / RECORD) as path:
        path.write_text(record.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return record


def restore(settings: Settings, folder: Path, on_copied: Callable[[int], None]) -> BackupRecord:
    """Make the service anew from a backup; an interrupted call is simply repeated.

    Args:
        settings: Its data directory, and a database without tables. No process uses them.
        folder: What `back_up` has made.
        on_copied: Called with the size of each file that was copied [bytes].

    Raises:
        ConfigError: The backup is not complete, damaged, or of another kind of database; or the
            database is in use.
        MorphError: The database cannot be loaded.
        OSError: A file cannot be read, or the disk refuses.
    """
    record = _read_record(folder)
    if record.database != _kind(settings):
        wanted = {
            "postgres": "Name an empty database in MORPH_DATABASE_URL.",
            "sqlite": "Unset MORPH_DATABASE_URL.",
        }
        raise ConfigError(f"This is a backup of {record.database}.", wanted[record.database])
    if has_tables(settings):
        raise ConfigError(
            "A service already exists here.",
            "Name an empty database in MORPH_DATABASE_URL, and another data directory in "
            "MORPH_DATA_DIR.",
        )
    root = Storage(settings.data_dir).root
    for name in FOLDERS:
        if (folder / name).is_dir():
            FolderCopy(folder / name, root / name, frozenset(), on_copied).update()
    load(settings, folder / DATABASE)
    return record


def _read_record(folder: Path) -> BackupRecord:
    """The record of a complete backup.

    Raises:
        ConfigError: It is none.
    """
    try:
        record = BackupRecord.model_validate_json((folder / RECORD).read_bytes())
    except (OSError, ValidationError):
        raise ConfigError(
            f"{folder} does not contain a complete backup.",
            "Repeat morph backup, which continues where it stopped.",
        ) from None
    if not _is_as_recorded(folder, record):
        raise ConfigError(
            f"Files of the backup in {folder} are missing or have changed since it was made.",
            "Use another backup.",
        )
    if damaged := _damaged(folder, record):
        more = f" and {len(damaged) - NAMES_SHOWN} more" if len(damaged) > NAMES_SHOWN else ""
        raise ConfigError(
            f"Files of the backup in {folder} are damaged: "
            f"{', '.join(damaged[:NAMES_SHOWN])}{more}.",
            f"Use another backup, or remove their lines from {RECORD} to restore them as they are.",
        )
    return record


def _is_as_recorded(folder: Path, record: BackupRecord) -> bool:
    dumped = folder / DATABASE
    if not dumped.is_file() or _size(folder) != (record.files, record.bytes):
        return False
    return record.database_sha256 in (None, file_sha256(dumped))


def _damaged(folder: Path, record: BackupRecord) -> list[str]:
    """Meshes and results in the backup that are not what they were."""
    files = {name: folder / name for name in sorted(record.digests)}
    return [
        name
        for name, path in files.items()
        if path.is_file() and file_sha256(path) != record.digests[name]
    ]


def _results(settings: Settings) -> dict[str, str]:
    """The digest of each result that the database knows, by its path in a backup."""
    queue = JobQueue(settings)
    try:
        return {
            f"jobs/{job.id}/{RESULT}": job.outcome.sha256
            for job in queue.all(states=[JobState.SUCCEEDED])
            if job.outcome is not None
        }
    except DBAPIError:  # an older version's tables, which know none
        return {}
    finally:
        queue.close()


def _meshes(folder: Path) -> dict[str, str]:
    """The digest of each mesh in a backup, by its path there."""
    found = (folder / "meshes").glob("*/mesh.*")
    return {path.relative_to(folder).as_posix(): path.parent.name for path in found}


def _size(folder: Path) -> tuple[int, int]:
    """Number of files in the copied folders, and their bytes."""
    sizes = [folder_size(folder / name) for name in FOLDERS]
    return sum(files for files, _ in sizes), sum(size for _, size in sizes)


def _kind(settings: Settings) -> Literal["sqlite", "postgres"]:
    return "postgres" if settings.on_postgres else "sqlite"


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]
