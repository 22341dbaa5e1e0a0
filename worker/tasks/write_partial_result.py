"""A result file of all the frames that a job has finished, also where its engine was killed.

An engine that ends by itself writes one. One that was killed leaves its frames in the run
directory, and at most an older result beside them; then it is written when somebody asks for it.
"""

from __future__ import annotations

from pathlib import Path

from chamfer_morph.worker.frame_reader import has_unsaved_frames
from chamfer_morph.worker.storage import Storage, writing
from morph_engine.errors import ResultError
from morph_engine.files import wait_for
from morph_engine.results.spool import Spool, spool_path
from morph_engine.results.trajectory import write_result

LOCK_SECONDS = 30.0


def run(job_dir: Path) -> None:
    """Write the result of a job that rests, unless it has all frames.

    Args:
        job_dir: The job's directory.

    Raises:
        ResultError: Its engine has not ended yet, a frame is damaged, or the disk refuses.
    """
    result = Storage(job_dir.parent.parent).result_path(job_dir.name)
    try:
        with writing("The result"), wait_for(job_dir / "lock", LOCK_SECONDS):
            if has_unsaved_frames(result):
                write_partial_result(result)
    except TimeoutError:
        raise ResultError(
            "The engine of the job is still stopping.", "Try again in a moment."
        ) from None


def write_partial_result(result: Path) -> None:
    """Make a result file of the frames that are finished, if there are any.

    Raises:
        ResultError: A frame is damaged, or the disk refuses.
    """
    if spool_path(result).exists():
        with Spool.open(result, writable=False) as spool:
            if spool.frame_count:
                write_result(spool, status="partial")
