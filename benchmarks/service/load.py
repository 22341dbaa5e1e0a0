"""What 50 watchers and 100 requests a second do to the API, and to two jobs that run beside them.

Load and rest alternate, and a second round has them the other way round, so that each frame of the
same jobs is computed with load and without. Frames are compared one by one, and the median of their
ratios counts. A frame belongs to a side if it lay in it from end to end.

API, load and both engines share the cores of one machine here, and where these are two, the engines
alone fill them. The main figure is therefore the CPU time that an engine needs for a frame; the
wall time beside it mostly tells how few cores there are. What the wall time is where a core is left
is measured too, with one job fewer. Latency counts from the moment a request was due, so a load
process that gets no core makes it look worse, never better; how late it sent is told beside it. 50
other jobs are listed beside the two, which makes a full page.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median, quantiles

import httpx
import psutil

from benchmarks.service.fairness import smallest
from benchmarks.service.load_generator import Burst
from benchmarks.service.local_service import LocalService, job_document, job_request, submit
from benchmarks.service.measurement import Measurement, counted
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker.event_log import EventLog
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.storage import Storage

ENGINES = 2
OTHERS = 50
FRAMES = 100
PHASE_SECONDS = 6.0
PHASES = 50
ROUNDS = 2
LOOK_SECONDS = 0.01
PATIENCE_SECONDS = 600.0


@dataclass(frozen=True)
class Cost:
    """What a frame cost [s].

    Attributes:
        cpu: CPU time of the engine from the end of the frame before to the end of this one.
        wall: Wall time that the engine took for it.
    """

    cpu: float
    wall: float


@dataclass(frozen=True)
class Schedule:
    """When there is load.

    Attributes:
        begin: When the first phase begins [s since 1970].
        turn: Even to begin with load, odd to begin with rest.
    """

    begin: float
    turn: int

    def phase(self, time: float) -> int:
        """Number of the phase at a time; negative before the first."""
        return math.floor((time - self.begin) / PHASE_SECONDS)

    def loaded(self, phase: int) -> bool:
        """Whether there is load in a phase."""
        return (phase + self.turn) % 2 == 0

    def bursts(self) -> list[tuple[float, float]]:
        """From and to when there is load."""
        edges = [self.begin + phase * PHASE_SECONDS for phase in range(PHASES + 1)]
        return [edge for phase, edge in enumerate(pairwise(edges)) if self.loaded(phase)]


@dataclass
class Engine:
    """An engine process whose frames are followed."""

    log: EventLog
    process: psutil.Process
    size: int = 0
    last_id: int = 0
    last_end: float = 0.0
    last_cpu: float = 0.0

    def frame(self) -> tuple[int, float, float, Cost] | None:
        """The frame that has just ended: its number, its begin and end, and what it cost."""
        size = self.log.path.stat().st_size
        if size == self.size:
            return None
        now, cpu = time.time(), cpu_seconds(self.process)
        self.size = size
        events = self.log.read(self.last_id)
        new = [event for event in events if event.type == "frame"]
        if not new:
            return None
        began, before = self.last_end, self.last_cpu
        self.last_id, self.last_end, self.last_cpu = events[-1].id, now, cpu
        if len(new) > 1 or not began:
            return None
        data = new[0].data
        return int(data["frame"]), began, now, Cost(cpu - before, float(data["seconds"]))


@dataclass
class Seen:
    """What was measured.

    Attributes:
        costs: Of each frame, with load and without.
        bursts: What the load saw.
        shares: CPU time per second of load, by process.
    """

    costs: dict[bool, dict[int, list[Cost]]] = field(
        default_factory=lambda: {True: defaultdict(list), False: defaultdict(list)}
    )
    bursts: list[Burst] = field(default_factory=list)
    shares: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))


def measure(service: LocalService) -> list[Measurement]:
    """Run both rounds and compare."""
    seen, spared = Seen(), Seen()
    fill_list(service)
    with service.served(ENGINES) as (api, supervisor):
        for turn in range(ROUNDS):
            one_round(service, api, supervisor, ENGINES, turn, seen)
        for turn in range(ROUNDS):
            one_round(service, api, supervisor, ENGINES - 1, turn, spared)
    latencies = [1000 * latency for burst in seen.bursts for latency in burst.latencies]
    delays = [1000 * delay for burst in seen.bursts for delay in burst.delays]
    errors = [error for burst in seen.bursts for error in burst.errors]
    events = sum(burst.events for burst in seen.bursts)
    percentiles = quantiles(latencies, n=100)
    return [
        Measurement(
            "API, 99th percentile",
            percentiles[98],
            150,
            "ms",
            f"{len(latencies)} requests in {len(seen.bursts)} bursts, "
            f"median {percentiles[49]:.0f} ms, {events} events to watchers",
        ),
        Measurement("load sent late, 99th percentile", quantiles(delays, n=100)[98], None, "ms"),
        counted("errors", len(errors), 0, "; ".join(errors[:3])),
        slowed("engine slowed, CPU time", seen, lambda cost: cost.cpu, 10),
        slowed("engine slowed, wall time", seen, lambda cost: cost.wall, None),
        slowed("one job, CPU time", spared, lambda cost: cost.cpu, 10),
        slowed("one job, wall time", spared, lambda cost: cost.wall, 10),
        *(
            Measurement(f"CPU time of {process}", 100 * median(shares), None, "% of a core")
            for process, shares in seen.shares.items()
        ),
    ]


def fill_list(service: LocalService) -> None:
    """Queue other jobs and cancel them, so that lists are long."""
    queue = JobQueue(service.settings)
    queue.migrate()
    spec = smallest()
    for _ in range(OTHERS):
        job = new_id()
        queue.enqueue(spec, job_id=job, owner="")
        queue.cancel(job)
    queue.close()


def one_round(
    service: LocalService,
    api: httpx.Client,
    supervisor: psutil.Process,
    count: int,
    turn: int,
    seen: Seen,
) -> None:
    """Follow some jobs while load comes and goes; adds what was seen."""
    jobs = [submit(api, job_request(FRAMES, points_per_cell_edge=2)) for _ in range(count)]
    for job in jobs:
        wait_until(partial(begun, api, job))
    storage = Storage(service.data_dir)
    engines = [Engine(storage.events(job), process_of(supervisor, job)) for job in jobs]
    schedule = Schedule(time.time() + 2, turn)
    asked = {"url": str(api.base_url), "jobs": jobs, "bursts": schedule.bursts()}
    with (service.data_dir / "load.jsonl").open("w+") as output:
        load = psutil.Popen(
            [sys.executable, "-m", "benchmarks.service.load_generator"],
            stdin=subprocess.PIPE,
            stdout=output,  # a pipe that nobody reads would fill up and stop it
            text=True,
            start_new_session=True,  # as if on another machine: not in one group with this process
        )
        try:
            json.dump(asked, load.stdin)
            load.stdin.close()
            processes = {"the API": process_of(supervisor, "api"), "the load": load}
            before = {name: cpu_seconds(process) for name, process in processes.items()}
            while all(alive(engine.process) for engine in engines):
                follow(engines, schedule, seen)
                time.sleep(LOOK_SECONDS)
            phases = range(schedule.phase(time.time()) + 1)
            loaded = PHASE_SECONDS * sum(map(schedule.loaded, phases))
            for name, process in processes.items():
                seen.shares[name].append((cpu_seconds(process) - before[name]) / loaded)
        finally:
            load.terminate()
            load.wait()
        output.seek(0)
        lines = [line for line in output if line.endswith("\n")]  # the end may have cut the last
        seen.bursts += [Burst(**json.loads(line)) for line in lines]
    for job in jobs:
        wait_until(partial(finished, api, job))


def follow(engines: list[Engine], schedule: Schedule, seen: Seen) -> None:
    """Add the frames that have just ended to the side on which they lay from end to end."""
    for engine in engines:
        try:
            frame = engine.frame()
        except psutil.Error:  # it has ended, too
            continue
        if frame is None:
            continue
        number, begin, end, cost = frame
        phase = schedule.phase(begin)
        if phase >= 0 and phase == schedule.phase(end):
            seen.costs[schedule.loaded(phase)][number].append(cost)


def slowed(
    what: str, seen: Seen, part: Callable[[Cost], float], limit: float | None
) -> Measurement:
    """By how much frames cost more with load."""
    with_load, without = seen.costs[True], seen.costs[False]
    both = sorted(with_load.keys() & without.keys())
    ratios = [
        fmean(map(part, with_load[frame])) / fmean(map(part, without[frame])) for frame in both
    ]
    usual = median(part(cost) for frame in both for cost in without[frame])
    note = f"{len(both)} frames of {usual:.2f} s without load"
    return Measurement(what, 100 * (median(ratios) - 1), limit, "%", note)


def process_of(supervisor: psutil.Process, word: str) -> psutil.Process:
    """The one process of a service with a word, or a folder of that name, in its command line."""
    return next(
        process
        for process in supervisor.children(recursive=True)
        if any(Path(argument).name == word for argument in process.cmdline())
    )


def cpu_seconds(process: psutil.Process) -> float:
    """CPU time of a process so far, all threads [s]."""
    times = process.cpu_times()
    return float(times.user + times.system)


def alive(process: psutil.Process) -> bool:
    """Whether a process computes."""
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def begun(api: httpx.Client, job: str) -> bool:
    """Whether a job has a frame."""
    return bool(job_document(api, job)["progress"]["frame"])


def finished(api: httpx.Client, job: str) -> bool:
    """Whether a job has all its frames."""
    return bool(job_document(api, job)["state"] == "succeeded")


def wait_until(reached: Callable[[], bool]) -> None:
    """Wait for something that has to come."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while not reached():
        if time.monotonic() > deadline:
            raise TimeoutError("The jobs stand still.")
        time.sleep(0.1)
