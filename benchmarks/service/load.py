"""What 50 watchers and 100 requests a second do to the API, and to two jobs that run beside them.

Load and rest alternate, and a second round has them the other way round, so that each frame of the
same two jobs is computed with load and without. Frames are compared one by one, and the median of
their ratios counts. A frame belongs to a side if it lay in it from end to end.

API, load and both engines share the cores of one machine here. The main figure is therefore the CPU
time that the engine needs for a frame; the wall time beside it mostly tells how few cores there are.
Latency counts from the moment a request was due, so a busy load process makes it look worse, never
better. 50 other jobs are listed beside the two, which makes a full page.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from statistics import median, quantiles

import httpx
import psutil

from benchmarks.service.fairness import smallest
from benchmarks.service.figures import Figure, counted
from benchmarks.service.place import Place, body, show, submit
from benchmarks.service.requests_and_watchers import REQUESTS_PER_SECOND, WATCHERS, Burst
from worker.event_log import EventLog
from worker.queue import JobQueue, new_job_id

ENGINES = 2
OTHERS = 50
FRAMES = 100
PHASE_SECONDS = 8.0
PHASES = 50
ROUNDS = 2
LOOK_SECONDS = 0.01


@dataclass(frozen=True)
class Cost:
    """What a frame cost [s].

    Attributes:
        cpu: CPU time of the engine from the end of the frame before to the end of this one.
        wall: Wall time that the engine took for it.
    """

    cpu: float
    wall: float


@dataclass
class Engine:
    """An engine process whose frames are followed."""

    log: EventLog
    process: psutil.Process
    size: int = 0
    last_id: int = 0
    ended_at: float = math.inf
    cpu: float = 0.0

    def look(self) -> list[tuple[int, float, Cost]]:
        """New frames, each with its number, when it began, and what it cost."""
        size = self.log.path.stat().st_size
        if size == self.size:
            return []
        now, times = time.time(), self.process.cpu_times()
        self.size = size
        new = [event for event in self.log.read(self.last_id) if event.type == "frame"]
        found = []
        cpu = times.user + times.system
        if len(new) == 1 and self.ended_at < math.inf:
            cost = Cost(cpu - self.cpu, float(new[0].data["seconds"]))
            found.append((int(new[0].data["frame"]), self.ended_at, cost))
        if new:
            self.last_id, self.ended_at, self.cpu = new[-1].id, now, cpu
        return found


def measure(place: Place) -> list[Figure]:
    """Run both rounds and compare."""
    costs: dict[bool, dict[int, list[Cost]]] = {True: defaultdict(list), False: defaultdict(list)}
    bursts: list[Burst] = []
    shares: dict[str, list[float]] = defaultdict(list)
    fill_list(place)
    with place.served(ENGINES) as (api, supervisor):
        for turn in range(ROUNDS):
            bursts += one_round(place, api, supervisor, turn, costs, shares)
    latencies = [1000 * latency for burst in bursts for latency in burst.latencies]
    errors = [error for burst in bursts for error in burst.errors]
    cut = quantiles(latencies, n=100)
    both = sorted(costs[True].keys() & costs[False].keys())
    seen = f"{len(latencies)} requests in {len(bursts)} bursts, median {cut[49]:.0f} ms"
    events = sum(burst.events for burst in bursts)
    return [
        Figure("API, 99th percentile", cut[98], 150, "ms", seen),
        counted("errors", len(errors), 0, "; ".join([f"{events} events arrived", *errors[:3]])),
        Figure("engine slowed, CPU time", slowed(costs, both, "cpu"), 10, "%", f"{len(both)} frames"),
        Figure("engine slowed, wall time", slowed(costs, both, "wall"), None, "%", "see the docstring"),
        *(Figure(f"CPU of {who}", 100 * median(s), None, "% of a core") for who, s in shares.items()),
    ]  # fmt: skip


def fill_list(place: Place) -> None:
    """Queue other jobs and cancel them, so that lists are long."""
    queue = JobQueue(place.settings)
    queue.migrate()
    spec = smallest()
    for _ in range(OTHERS):
        job = new_job_id()
        queue.enqueue(spec, job_id=job, owner="")
        queue.cancel(job)
    queue.close()


def one_round(
    place: Place,
    api: httpx.Client,
    supervisor: psutil.Process,
    turn: int,
    costs: dict[bool, dict[int, list[Cost]]],
    shares: dict[str, list[float]],
) -> list[Burst]:
    """Two jobs from begin to end under bursts of load; adds the costs of their frames."""
    jobs = [submit(api, body(FRAMES, points_per_cell_edge=2)) for _ in range(ENGINES)]
    engines = [followed(place.data_dir, supervisor, job) for job in jobs]
    begin = time.time() + 2
    edges = [begin + phase * PHASE_SECONDS for phase in range(PHASES)]
    loads = [(edge, edge + PHASE_SECONDS) for edge in edges[turn % 2 :: 2]]
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.service.requests_and_watchers"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None and process.stdout is not None
        json.dump({"url": str(api.base_url), "jobs": jobs, "bursts": loads}, process.stdin)
        process.stdin.close()
        load = {"the API": child(supervisor, "server", "api"), "the load": psutil.Process(process.pid)}
        before, phase = {}, -1
        while all(engine.process.is_running() and engine.process.status() != "zombie" for engine in engines):
            now = time.time()
            for engine in engines:
                for frame, began, cost in engine.look():
                    side = phase_of(began, begin)
                    if side >= 0 and side == phase_of(now, begin):
                        costs[(side + turn) % 2 == 0][frame].append(cost)
            if phase_of(now, begin) != phase:
                spent = {who: sum(p.cpu_times()[:2]) for who, p in load.items()}
                if before and (phase + turn) % 2 == 0 and phase >= 0:
                    for who in load:
                        shares[who].append((spent[who] - before[who]) / PHASE_SECONDS)
                before, phase = spent, phase_of(now, begin)
            time.sleep(LOOK_SECONDS)
        process.terminate()
        bursts = [Burst(**json.loads(line)) for line in process.stdout]
    return bursts
