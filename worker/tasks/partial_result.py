"""A result file of all the frames that a job has finished, also where its engine was killed.

An engine that ends by itself writes one. One that was killed leaves its frames in the run
directory, and at most an older result beside them; then it is written when somebody asks for it,
by a child: this module, run with JOB_DIR.
"""

from __future__ import annotations

import sys
from pathlib import Path

from chamfer_morph.worker import sandbox
from chamfer_morph.worker.frame_reader import has_unkept_frames
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from chamfer_morph.worker.tasks.file_task import Making, make_file, saying_why
from morph_engine.errors import ResultError
from morph_engine.files import wait_for
from morph_engine.results.spool import Spool, spool_path
from morph_engine.results.trajectory import write_result

LOCK_SECONDS = 30.0
RESULT = Making("The result", "write", "Fetch single frames.")


def keep_frames(result: Path) -> None:
    """Make a result file of the frames that are finished, if there are any.

    Raises:
        ResultError: A frame is damaged, or the disk refuses.
    """
    if spool_path(result).exists():
        with Spool.open(result, writable=False) as spool:
            if spool.frame_count:
                write_result(spool, status="partial")


def keep_result(storage: Storage, job_id: str, settings: Settings) -> None:
    """See to it that the result of a job that rests has all its frames; blocks.

    Raises:
        MorphError: It cannot be written, or takes too much memory or time.
    """
    if not has_unkept_frames(storage.result_path(job_id)):
        return
    make_file(
        __name__,
        [str(storage.job_dir(job_id))],
        RESULT,
        settings,
    )


def _main() -> None:
    sandbox.enter()
    job_dir = Path(sys.argv[1])
    result = Storage(job_dir.parent.parent).result_path(job_dir.name)
    with saying_why(RESULT):
        try:
            with wait_for(job_dir / "lock", LOCK_SECONDS):  # an engine may be ending
                if has_unkept_frames(result):
                    keep_frames(result)
        except TimeoutError:
            raise ResultError(
                "The engine of the job has not ended yet.", "Ask again soon."
            ) from None


if __name__ == "__main__":
    _main()
