"""Full states of a job after some of its frames: what a fork begins with.

The last one is in the run directory as long as the job has not succeeded; others are kept where the
job was asked to.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Literal

from chamfer_morph.worker.storage import Storage
from morph_engine.errors import ResultError
from morph_engine.results.spool import Checkpoint, checkpoint_path, keep_checkpoint, read_checkpoint

BYTES_OF_PARTICLE = 100
"""Of a state in single precision: position, velocity, affine velocity and deformation gradient."""


def states_bytes(
    particle_count: int,
    frames: int,
    states_every: int,
    precision: Literal["float32", "float64"] = "float32",
) -> int:
    """About the disk that the states fill which a job keeps [bytes]."""
    count = frames // states_every if states_every else 0
    return BYTES_OF_PARTICLE * (2 if precision == "float64" else 1) * particle_count * count


def keep_state(storage: Storage, job_id: str, frame: int) -> None:
    """Keep the state after the last frame of a job that is being computed.

    Args:
        storage: The data directory.
        job_id: The job.
        frame: Index of that frame.

    Raises:
        ResultError: The disk refuses.
    """
    path = storage.state_path(job_id, frame)
    if not path.exists():
        keep_checkpoint(storage.result_path(job_id), path)


def find_state(storage: Storage, job_id: str, frame: int | None) -> Checkpoint:
    """The state of a job after a frame; None for the last that there is.

    Raises:
        ResultError: There is none; the message names those that there are.
    """
    last = _last_state(storage, job_id)
    kept = sorted(int(path.stem) for path in storage.states_dir(job_id).glob("*.npz"))
    if last and frame in (None, last.frame):
        return last
    wanted = kept[-1] if frame is None and kept else frame
    if wanted in kept:
        return read_checkpoint(storage.state_path(job_id, wanted))
    there = ", ".join(map(str, sorted({*kept, *([last.frame] if last else [])})))
    raise ResultError(
        f"The job has no full state after frame {frame}, only after {there}."
        if there
        else "The job has no full state from which a fork could start.",
        "Fork at one of these." if there else "Submit it again with `states_every`.",
    )


def _last_state(storage: Storage, job_id: str) -> Checkpoint | None:
    """The state in the run directory, if that is there."""
    with suppress(ResultError):
        return read_checkpoint(checkpoint_path(storage.result_path(job_id)))
    return None
