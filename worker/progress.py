"""How far a job has come, read from the end of its event log."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import get_args

from chamfer_morph.schemas import Event, JobStage
from chamfer_morph.worker.event_log import EventLog
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.storage import Storage

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class JobProgress:
    """How far a job has come; the same object as long as its log stays as it is.

    Attributes:
        frame: Finished frames.
        frames: Frames asked for.
        attempt: Number of the current attempt; 0 before the first.
        metrics: Metrics of the last finished frame.
        seconds_left: Estimate of the time left [s], None without a frame to judge by.
        stage: What goes on before the first frame of an attempt, None once that is there.
    """

    frame: int
    frames: int
    attempt: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    seconds_left: float | None = None
    stage: JobStage | None = None


def read_progress(storage: Storage, job_id: str, spec: JobSpec) -> JobProgress:
    """The progress of a job; none where its log is damaged, which must not hide other jobs."""
    log, frames = storage.events(job_id), spec.frame_count
    try:
        return _progress(log, log.version(), frames)
    except (OSError, LookupError, TypeError, ValueError, AttributeError):
        _LOG.warning("the event log of job %s cannot be read", job_id, exc_info=True)
        return JobProgress(0, frames)


@lru_cache(4096)
def _progress(log: EventLog, version: tuple[int, int], total: int) -> JobProgress:
    """The progress at the end of one version of a log, read once."""
    events = log.tail()
    frames = [event for event in events if event.type == "frame"]
    attempts = [int(event.data["attempt"]) for event in events if "attempt" in event.data]
    stage = _stage(events)
    if not frames:
        return JobProgress(0, total, max(attempts, default=0), stage=stage)
    last = frames[-1].data
    done = int(last["frame"]) + 1
    seconds = [float(event.data["seconds"]) for event in frames[-5:]]
    return JobProgress(
        frame=done,
        frames=total,
        attempt=int(last["attempt"]),
        metrics={name: float(value) for name, value in last["metrics"].items()},
        seconds_left=(total - done) * sum(seconds) / len(seconds),
        stage=stage,
    )


def _stage(events: Sequence[Event]) -> JobStage | None:
    """The stage that the last events tell, unless a frame or another attempt came after it."""
    last = next((e for e in reversed(events) if e.type in ("stage", "frame", "attempt")), None)
    if last is None or last.type != "stage" or last.data["stage"] not in get_args(JobStage):
        return None
    stage: JobStage = last.data["stage"]
    return stage
