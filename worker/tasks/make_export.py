"""An export of a result, kept beside the job."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Callable
from pathlib import Path

from chamfer_morph.worker.sandbox.derived_files import ExportOptions, StoredExport
from morph_engine.child_process import lower_priority
from morph_engine.errors import MorphError, ResourceError
from morph_engine.export import export, find, suffix
from morph_engine.files import file_sha256, replacing, wait_for

DISK_FULL = (errno.EFBIG, errno.ENOSPC, errno.EDQUOT)


def run(
    result: Path, folder: Path, options: ExportOptions, report_progress: Callable[[float], None]
) -> None:
    """Make an export unless it is there.

    Args:
        result: The result file.
        folder: Where exports are kept.
        options: What to export.
        report_progress: Called with the share that is done.

    Raises:
        ResourceError: The disk is full.
        MorphError: It cannot be made.
    """
    lower_priority()
    with wait_for(folder / "lock"):  # another API may be at it
        if StoredExport.find(folder, options.id) is not None:
            return
        _remove_leftovers(folder)
        ending = suffix(options.format, options.frames, tracked=options.tracked)
        path = folder / f"{options.id}{ending}"
        try:
            export(
                result,
                path,
                options.format,
                **options.content,
                units=options.units,
                watch=lambda done, total: report_progress(done / max(total, 1)),
            )
        except MorphError as error:
            if isinstance(error.__cause__, OSError) and error.__cause__.errno in DISK_FULL:
                raise ResourceError(
                    "The export does not fit on the disk or in the disk quota of this key.",
                    "Delete exports and jobs that are no longer needed.",
                ) from error
            raise
        stored = StoredExport(
            file=path.name,
            name=f"{options.name}{ending}",
            media_type="application/zip" if ending == ".zip" else find(options.format).media_type,
            size_bytes=path.stat().st_size,
            sha256=file_sha256(path),
        )
        with replacing(folder / f"{options.id}.json") as temporary:
            temporary.write_text(stored.model_dump_json(), encoding="utf-8")


def _remove_leftovers(folder: Path) -> None:
    """Remove what exports have left behind that were killed; nobody else is at work here."""
    documents = list(folder.glob("*.json"))
    files = [StoredExport.model_validate_json(text.read_text("utf-8")).file for text in documents]
    stored = {"lock", *files, *(text.name for text in documents)}
    for entry in folder.iterdir():
        if entry.name in stored:
            continue
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)
