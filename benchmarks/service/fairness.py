"""Two keys with 500 queued jobs each share two workers: whose jobs start, and what asking costs.

All jobs of one key are queued before the first of the other. Keys have to take turns all the same.
Two workers may take the heads of both keys in either order, so that one key may be ahead by one job
for its turn, and by one for each further worker. The operations are timed while the workers run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from itertools import accumulate, groupby, pairwise
from statistics import median

from benchmarks.service.local_service import LocalService, job_request
from benchmarks.service.measurement import Measurement, counted
from chamfer_morph.schemas import JobRequest, JobState
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.server.submission import configure
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.queue import JobQueue

KEYS = ("first", "second")
JOBS_PER_KEY = 500
WORKERS = 2
TO_FINISH = 40
REPEATS = 21
PATIENCE_SECONDS = 900.0


def measure(service: LocalService) -> list[Measurement]:
    """Fill the queue, ask it, and let the workers take some jobs."""
    queue = JobQueue(service.settings)
    queue.migrate()
    already = queue.counts()[JobState.SUCCEEDED]
    spec = smallest()
    ids = {key: [new_id() for _ in range(JOBS_PER_KEY)] for key in KEYS}
    filling = [
        timed(partial(queue.enqueue, spec, job_id=job, owner=key))
        for key in KEYS
        for job in ids[key]
    ]
    with service.served(WORKERS):
        wait_for(queue, lambda counts: counts[JobState.RUNNING] == WORKERS)
        asking = operations(queue, spec, ids[KEYS[1]][-1])
        wait_for(queue, lambda counts: counts[JobState.SUCCEEDED] >= already + TO_FINISH)
    states = set(JobState) - {JobState.QUEUED}
    begun = [record for key in KEYS for record in queue.newest(owner=key, states=states)]
    for record in queue.newest(states={JobState.QUEUED, JobState.RUNNING}, limit=10**6):
        queue.cancel(record.id)
    queue.close()
    return [
        Measurement("enqueue, queue filling", 1000 * median(filling), 100, "ms"),
        *(Measurement(f"{name}, 1000 queued", 1000 * t, 100, "ms") for name, t in asking.items()),
        counted("jobs a key is ahead", lead(begun), WORKERS, f"over {len(begun)} starts"),
        counted("two jobs in a slot", overlaps(begun), 0),
        counted("jobs that failed", sum(r.state is JobState.FAILED for r in begun), 0),
    ]


def smallest() -> JobSpec:
    """The smallest job there is."""
    request = JobRequest.model_validate(job_request(frames=1))
    return JobSpec(
        source=request.source,
        target=request.target,
        config=configure(request),
        device=request.device,
        timeout_seconds=3600,
    )


def operations(queue: JobQueue, spec: JobSpec, job: str) -> dict[str, float]:
    """Median time of each operation [s]; a job more for either key in turn is queued and left."""
    turns = iter(KEYS * REPEATS)
    calls: dict[str, Callable[[], object]] = {
        "get": lambda: queue.get(job),
        "list of 50": lambda: queue.newest(limit=50),
        "list of a key's 50": lambda: queue.newest(
            owner=KEYS[0], states={JobState.QUEUED}, limit=50
        ),
        "counts": queue.counts,
        "counts of a key": lambda: queue.counts(KEYS[0]),
        "position": lambda: queue.position(job),
        "enqueue": lambda: queue.enqueue(spec, job_id=new_id(), owner=next(turns)),
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(REPEATS):
        for name, call in calls.items():
            times[name].append(timed(call))
            time.sleep(0.05)
    return {name: median(of_one) for name, of_one in times.items()}


def lead(begun: Sequence[JobRecord]) -> int:
    """The most jobs that one key has ever been ahead of the other."""
    order = sorted(begun, key=lambda record: (started(record), record.id))
    return max(map(abs, accumulate(1 if r.owner == KEYS[0] else -1 for r in order)))


def overlaps(begun: Sequence[JobRecord]) -> int:
    """How often a slot started a job before it had finished the one before."""
    order = sorted(begun, key=lambda record: (str(record.executor), started(record)))
    return sum(
        earlier.finished_at is None or earlier.finished_at > started(later)
        for _, jobs in groupby(order, key=lambda record: record.executor)
        for earlier, later in pairwise(jobs)
    )


def started(record: JobRecord) -> datetime:
    """When a job that is no longer queued was started."""
    assert record.started_at is not None
    return record.started_at


def wait_for(queue: JobQueue, reached: Callable[[dict[JobState, int]], bool]) -> None:
    """Wait until the numbers of jobs in each state are as wished."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while not reached(counts := queue.counts()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"The workers stand still: {counts}")
        time.sleep(0.5)


def timed(call: Callable[[], object]) -> float:
    """Wall time of a call [s]."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin
