"""Kill the service at random while it works, and count what was lost.

    python -m benchmarks.soak --kills 200 --jobs 40 [--database postgresql://...]

A real `morph serve` computes small jobs that were submitted over HTTP. Again and again one of its
processes (a worker, an engine, the API, the janitor, the supervisor itself) gets SIGKILL. Since
engines are killed faster than they start on a busy machine, a job has ten attempts here. In the end
every job must have succeeded once, with the particles of a run that nothing disturbed, and with
at most one frame computed again for each kill.

    python -m benchmarks.soak --kills 0 --jobs 2000

Kills nothing, and measures instead whether the service grows: memory and open files of its lasting
processes, its children, its connections to Postgres, and how long an answer takes, in the last
fifth of the jobs against the second. After both, no process and no connection may be left.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import psutil

from benchmarks.service.postgres_load import connections_to
from morph_engine.results.trajectory import Trajectory

KINDS = {
    "worker": ["chamfer_morph.worker", "run"],
    "engine": ["chamfer_morph.worker.engine_process"],
    "API": ["chamfer_morph.server", "api"],
    "janitor": ["chamfer_morph.worker", "janitor"],
    "supervisor": ["chamfer_morph.server", "serve"],
}
PATIENCE_SECONDS = 1800.0
"""How long jobs may take together, or one of them where nothing is killed [s]."""

SAMPLING_SECONDS = 3.0
"""Pause after each measurement of the service, which itself takes processor time [s]."""

LASTING = ("API", "janitor", "worker", "supervisor")
LARGEST_GROWTH = 1.1


@dataclass
class Service:
    """A `morph serve` that is started again whenever its supervisor has died."""

    data_dir: Path
    database_url: str
    port: int
    workers: int
    supervisor: subprocess.Popen[bytes] | None = None
    kills: Counter[str] = field(default_factory=Counter)
    _seen: set[psutil.Process] = field(default_factory=set)

    def keep_alive(self) -> None:
        """Start the supervisor if it is not there."""
        if self.supervisor is not None and self.supervisor.poll() is None:
            return
        own = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
        with (self.data_dir / "service.log").open("ab") as log:
            self.supervisor = subprocess.Popen(
                [sys.executable, "-m", "chamfer_morph.server", "serve"],
                env=own
                | {
                    "MORPH_DATA_DIR": str(self.data_dir),
                    "MORPH_DATABASE_URL": self.database_url,
                    "MORPH_PORT": str(self.port),
                    "MORPH_WORKERS": str(self.workers),
                    "MORPH_THREADS": "1",
                    "MORPH_POLL_SECONDS": "0.1",
                    "MORPH_ADOPTION_SECONDS": "0.5",
                    "MORPH_RETRY_SECONDS": "0.2",
                    "MORPH_ATTEMPTS": "10",
                    "MORPH_QUEUED_JOBS_PER_KEY": "100000",
                },
                stdout=log,
                stderr=log,
            )

    def kill_one(self, chance: random.Random) -> None:
        """Kill a process of a random kind."""
        family = self._family()
        kind = chance.choice(sorted(family))
        victim = chance.choice(family[kind])
        try:
            victim.send_signal(signal.SIGKILL)
        except psutil.Error:
            return
        self.kills[kind] += 1
        if kind == "supervisor" and self.supervisor is not None:
            self.supervisor.wait()

    def stop(self) -> list[str]:
        """End all of it; returns what is left of it nevertheless."""
        if self.supervisor is not None:
            self.supervisor.terminate()
            self.supervisor.wait(20)
        deadline = time.monotonic() + 20
        while (left := self.left()) and time.monotonic() < deadline:
            time.sleep(0.2)
        return left

    def left(self) -> list[str]:
        """Processes and connections of this service, in words."""
        processes = [f"{process.pid} is left" for process in self._processes()]
        connections = self.connections()
        return processes + [f"{connections} connections are left"] * bool(connections)

    def connections(self) -> int:
        """Connections to the database, none of them being this one; 0 on SQLite."""
        return connections_to(self.database_url) if self.database_url else 0

    def size(self) -> dict[str, float]:
        """Memory [bytes] and files of processes that last; all processes; connections."""
        found = [(kind, process) for kind in LASTING for process in self._family().get(kind, [])]
        size: Counter[str] = Counter()
        for kind, process in found:
            size[f"memory of {kind}"] += process.memory_info().rss
            size[f"files of {kind}"] += process.num_fds()
        size["processes"] = len(self._processes())
        if self.database_url:
            size["connections"] = self.connections()
        return dict(size)

    def _family(self) -> dict[str, list[psutil.Process]]:
        """Processes of this service by kind; those of a dead supervisor may still be about."""
        family: dict[str, list[psutil.Process]] = {}
        for process in self._processes():
            with suppress(psutil.Error):  # it has ended
                command = process.cmdline()
                for kind, words in KINDS.items():
                    if all(word in command for word in words):
                        family.setdefault(kind, []).append(process)
        return family

    def _processes(self) -> list[psutil.Process]:
        """Every process of this service; children are not told whose they are, and are kept."""
        for process in psutil.process_iter():
            with suppress(psutil.Error):  # it has ended
                if process.environ().get("MORPH_DATA_DIR") == str(self.data_dir):
                    self._seen.update([process, *process.children(recursive=True)])
        self._seen = {process for process in self._seen if runs(process)}
        return [*self._seen]


def runs(process: psutil.Process) -> bool:
    """Whether a process has not ended."""
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def main() -> int:
    """Run the trial and print what came of it; returns the number of faults found."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=40)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--interval", type=float, default=1.5, help="mean time between kills [s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--database", default="", help="URL of an empty Postgres database")
    options = parser.parse_args()
    chance = random.Random(options.seed)
    with tempfile.TemporaryDirectory(prefix="morph-soak-") as folder, socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        service = Service(Path(folder), options.database, port, options.workers)
        expected = undisturbed(Path(folder), options.frames)
        service.keep_alive()
        started = time.monotonic()
        try:
            jobs = [submit(service, number, options.frames) for number in range(options.jobs)]
            growth: list[str] = []
            if options.kills:
                states = kill_until_done(service, chance, jobs, options.kills, options.interval)
            else:
                states, growth = measure_until_done(service, jobs)
            faults = growth + [
                fault for job in jobs for fault in faults_of(service, job, states, expected)
            ]
            again = sum(max(len(frames(service, job)) - options.frames, 0) for job in jobs)
        finally:
            left = service.stop()
        faults += left
        total = sum(service.kills.values())
        listed = len(states)
        print(f"{options.jobs} jobs, {listed} listed, {time.monotonic() - started:.0f} s")
        print(f"{total} kills: " + ", ".join(f"{n} {kind}" for kind, n in service.kills.items()))
        print(f"states: {dict(Counter(states.values()))}")
        print(f"frames computed again: {again}, allowed {total}")
        if again > total:
            faults.append("too many frames computed again")
        if listed != options.jobs:
            faults.append(f"{listed} jobs listed")
        print("\n".join(faults) or "nothing lost, nothing twice, every result as undisturbed")
        if faults:
            print((Path(folder) / "service.log").read_text()[-4000:])
    return len(faults)


def undisturbed(folder: Path, frame_count: int) -> np.ndarray:
    """Positions of the job when nothing disturbs it."""
    out = folder / "undisturbed.vtkhdf"
    subprocess.run(
        [sys.executable, "-m", "chamfer_morph", "run", "sphere", "star", "--method", "joint",
         "--points-per-cell-edge", "1", "--frames", str(frame_count), "--device", "cpu",
         "--out", out, "--quiet"],
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    with Trajectory(out) as result:
        return np.stack(list(result))


def submit(service: Service, number: int, frame_count: int) -> str:
    """Submit a job, however often it takes; the key makes it one job."""
    body = {
        "source": {"shape": "sphere"},
        "target": {"shape": "star"},
        "overrides": {"sampling.points_per_cell_edge": 1},
        "method": "joint",
        "frames": frame_count,
        "device": "cpu",
    }
    answer = ask(service, "POST", "/v1/jobs", json=body, headers={"Idempotency-Key": f"{number}"})
    return answer["id"]


def ask(service: Service, method: str, path: str, **arguments):
    """An answer of the API, which may be dead at the moment."""
    deadline = time.monotonic() + 60
    while True:
        try:
            url = f"http://127.0.0.1:{service.port}{path}"
            answer = httpx.request(method, url, timeout=20, **arguments)
            if answer.status_code < 500:
                answer.raise_for_status()
                return answer.json()
        except httpx.TransportError:
            if time.monotonic() > deadline:
                raise
        service.keep_alive()
        time.sleep(0.2)


def kill_until_done(
    service: Service, chance: random.Random, jobs: list[str], kills: int, interval: float
) -> dict[str, str]:
    """Kill while jobs run, then let them end; returns the state of every job there is."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while True:
        service.keep_alive()
        if sum(service.kills.values()) < kills:
            time.sleep(chance.expovariate(1 / interval))
            service.kill_one(chance)
        else:
            time.sleep(1)
        states = listed(service)
        unfinished = [job for job in jobs if states.get(job) in (None, "queued", "running")]
        if not unfinished or time.monotonic() > deadline:
            return states


def measure_until_done(service: Service, jobs: list[str]) -> tuple[dict[str, str], list[str]]:
    """Measure while jobs run; returns the state of every job there is, and what has grown."""
    samples: list[tuple[int, dict[str, float]]] = []
    finished, since = 0, time.monotonic()
    while finished < len(jobs) and time.monotonic() - since < PATIENCE_SECONDS:
        began = time.perf_counter()
        ask(service, "GET", "/v1/jobs", params={"limit": 20})
        sample = {"answer": time.perf_counter() - began} | service.size()
        metrics = httpx.get(f"http://127.0.0.1:{service.port}/metrics", timeout=20).text
        counts = re.findall(r'^morph_jobs{state="(?:succeeded|failed)"} (\S+)', metrics, re.M)
        now = int(sum(map(float, counts)))
        if now > finished:
            finished, since = now, time.monotonic()
        samples.append((finished, sample))
        time.sleep(SAMPLING_SECONDS)
    grown = []
    for name in sorted(samples[-1][1]):
        first, last = (
            statistics.median(
                sample[name]
                for count, sample in samples
                if name in sample and low <= count / len(jobs) <= low + 0.2
            )
            for low in (0.2, 0.8)
        )
        print(f"{name}: {first:.4g} in the second fifth, {last:.4g} in the last")
        if last > LARGEST_GROWTH * first:
            grown.append(f"{name} has grown by {100 * (last / first - 1):.0f} %")
    return listed(service), grown


def listed(service: Service) -> dict[str, str]:
    """States of all jobs."""
    states, cursor = {}, None
    while True:
        parameters = {"limit": 100} | ({"cursor": cursor} if cursor else {})
        page = ask(service, "GET", "/v1/jobs", params=parameters)
        states |= {job["id"]: job["state"] for job in page["items"]}
        cursor = page["next_cursor"]
        if not cursor:
            return states


def frames(service: Service, job: str) -> list[int]:
    """Frames that were computed, repetitions included."""
    events = ask(service, "GET", f"/v1/jobs/{job}/events", params={"limit": 1000})["items"]
    return [event["data"]["frame"] for event in events if event["type"] == "frame"]


def faults_of(
    service: Service, job: str, states: dict[str, str], expected: np.ndarray
) -> list[str]:
    """What is wrong with a job."""
    if states.get(job) != "succeeded":
        problem = ask(service, "GET", f"/v1/jobs/{job}")["problem"]
        return [f"{job} is {states.get(job)}: {problem}"]
    path = service.data_dir / "jobs" / job / "result.vtkhdf"
    with Trajectory(path) as result:
        same = result.status == "complete" and np.array_equal(np.stack(list(result)), expected)
    return [] if same else [f"{job} differs from an undisturbed run"]


if __name__ == "__main__":
    sys.exit(main())
