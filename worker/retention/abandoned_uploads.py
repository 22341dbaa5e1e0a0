"""Uploads whose API was killed: what had come of them lies about and belongs to nobody."""

from __future__ import annotations

import contextlib
import time

from chamfer_morph.worker.storage import Storage

ABANDONED_SECONDS = 3600.0
"""An upload that has not grown for so long belongs to nobody."""


def delete_abandoned_uploads(storage: Storage) -> list[str]:
    """Delete what an API that was killed had received of files; needs a clock that is right.

    Returns:
        Names of the deleted files.
    """
    deleted = []
    for path in storage.uploads.iterdir():
        with contextlib.suppress(FileNotFoundError):  # it has arrived meanwhile
            if time.time() - path.stat().st_mtime > ABANDONED_SECONDS:
                path.unlink()
                deleted.append(path.name)
    return deleted
