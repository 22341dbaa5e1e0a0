"""A job in traces and logs: what of them lies in the queue with it, and the spans of a run of it.

Every run of a job, by whichever worker, is a child of the request that submitted it. One that was
asked for by another request, to resume or retry the job, has a link to that, or is its child if the
job was submitted without traces.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from chamfer_morph.schemas import Event
from chamfer_morph.worker import service_log, telemetry

QUEUED_AT, REQUEST = "queued_at", "run_request"
"""Attributes of a job beside its carrier: when it was queued last [ns]; the carrier of who did."""

REQUEST_ID = "request_id"
"""Attribute of a job: id of the request that has queued it last."""


def of_submission() -> dict[str, Any]:
    """What to attach to a job that is queued now: of its request, and of traces if they are on."""
    return _request() | (
        {**telemetry.carrier(), QUEUED_AT: time.time_ns()} if telemetry.is_on() else {}
    )


def of_next_run() -> dict[str, Any]:
    """What to attach to a job that is queued again now."""
    return _request() | (
        {REQUEST: telemetry.carrier(), QUEUED_AT: time.time_ns()} if telemetry.is_on() else {}
    )


def _request() -> dict[str, Any]:
    request = service_log.request_id.get()
    return {REQUEST_ID: request} if request else {}


@dataclass(frozen=True)
class Run:
    """A run of a job.

    Attributes:
        begun: When it began [ns since 1970].
        queued_at: When the job was queued [ns since 1970]; None where nobody knows.
        parent: Carrier of the request that it belongs to; empty where there is none.
        about: Attributes of its spans.
    """

    begun: int
    queued_at: int | None
    parent: Mapping[str, str]
    about: Mapping[str, str]

    def record_wait(self, events: Sequence[Event]) -> None:
        """Tell how long the job has waited: since it was queued, or the last event of a lost run.

        Args:
            events: What has happened to the job before.
        """
        if self.queued_at is None or not self.parent:
            return
        last = max((round(event.at.timestamp() * 1e9) for event in events), default=0)
        since = max(self.queued_at, last)
        telemetry.record("queue", since, self.begun, self.about, self.parent)


@contextmanager
def run_of(job_id: str, attributes: Mapping[str, Any], worker: str) -> Iterator[Run]:
    """The span of a run.

    Args:
        job_id: The job.
        attributes: What is attached to it.
        worker: The slot that runs it.
    """
    about = {"morph.job.id": job_id, "morph.worker": worker}
    request = attributes.get(REQUEST)
    parent = telemetry.carried(attributes) or request or {}
    with telemetry.span("job", about, parent=parent, link=request, kind="consumer"):
        yield Run(time.time_ns(), attributes.get(QUEUED_AT), parent, about)
