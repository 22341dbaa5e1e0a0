"""Kill workers and cut links of hosts that share no folder, and count what was lost.

    python -m benchmarks.many_hosts --database postgresql://... --jobs 300 --faults 100

Each host has a folder of its own, a janitor and workers, which reach an empty Postgres database and
an S3 server over links of their own. Again and again a process gets SIGKILL, stands still for some
seconds, or a link is cut, silent one way or both, or slow for some. In the end every job must have
succeeded once, with the particles of a run that nothing disturbed.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import sqlalchemy as sa

from benchmarks.soak import undisturbed
from chamfer_morph.schemas import BuiltInShape, JobState
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import open_storage
from morph_engine.presets import configure
from morph_engine.results.trajectory import Trajectory
from tests.object_store import BUCKET, Link, s3_server

CREDENTIALS = {"AWS_ACCESS_KEY_ID": "id", "AWS_SECRET_ACCESS_KEY": "secret"}
LONGEST_PAUSE = 20.0
"""How long a process stands still or a link is cut at most [s]."""

PATIENCE_SECONDS = 5400.0

SLOW_SECONDS = 0.2


def slow_down(link: Link) -> None:
    """Hold up what goes over a link."""
    link.delay = SLOW_SECONDS


TROUBLES: dict[str, Callable[[Link], None]] = {
    "cut": Link.cut,
    "silent": Link.silence,
    "silent there": partial(Link.silence, back=False),
    "silent back": partial(Link.silence, there=False),
    "slow": slow_down,
}
"""What may happen to a link."""


@dataclass
class Host:
    """Processes with a folder and links of their own.

    Attributes:
        folder: What it has of disk.
        environment: Settings of its processes.
        links: To the database and to the object store.
        processes: Those that are to run, by their arguments.
    """

    folder: Path
    environment: dict[str, str]
    links: dict[str, Link]
    processes: dict[tuple[str, ...], subprocess.Popen[bytes] | None] = field(default_factory=dict)

    def keep_alive(self) -> None:
        """Start what does not run."""
        for arguments, process in self.processes.items():
            if process is None or process.poll() is not None:
                with (self.folder / "processes.log").open("ab") as log:
                    self.processes[arguments] = subprocess.Popen(
                        [sys.executable, "-m", "chamfer_morph.worker", *arguments],
                        env=self.environment, stderr=log,
                    )  # fmt: skip

    def disturb(self, chance: random.Random) -> str:
        """Let something go wrong; returns what."""
        kind = chance.choice(["kill", "kill", "engine", "stop", "database", "store"])
        seconds = chance.uniform(1, LONGEST_PAUSE)
        if kind in self.links:
            link, how = self.links[kind], chance.choice([*TROUBLES])
            TROUBLES[how](link)
            threading.Timer(seconds, link.mend).start()
            return f"{kind} {how}"
        with suppress(psutil.Error, ValueError):
            process = psutil.Process(chance.choice([*self.processes.values()]).pid)
            if kind == "engine":
                process = chance.choice(process.children() or [process])
            process.send_signal(signal.SIGSTOP if kind == "stop" else signal.SIGKILL)
            if kind == "stop":
                threading.Timer(seconds, self._go_on, (process,)).start()
        names = {"kill": "worker killed", "engine": "engine killed", "stop": "worker stopped"}
        return names[kind]

    def end(self) -> None:
        """End all of it."""
        for process in self.processes.values():
            if process is not None:
                process.kill()
                process.wait()
        for link in self.links.values():
            link.close()

    @staticmethod
    def _go_on(process: psutil.Process) -> None:
        with suppress(psutil.Error):
            process.send_signal(signal.SIGCONT)


def main() -> int:
    """Run the trial and print what came of it; returns the number of faults found."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.many_hosts", description=__doc__)
    parser.add_argument("--database", required=True, help="URL of an empty Postgres database")
    parser.add_argument("--hosts", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2, help="of each host")
    parser.add_argument("--jobs", type=int, default=300)
    parser.add_argument("--faults", type=int, default=100)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--interval", type=float, default=6.0, help="mean time between faults [s]")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    with tempfile.TemporaryDirectory(prefix="morph-hosts-") as name:
        folder = Path(name)
        expected = undisturbed(folder, options.frames)
        with s3_server(folder / "s3.log") as store:
            os.environ |= CREDENTIALS | {"AWS_ENDPOINT_URL": f"http://{store[0]}:{store[1]}"}
            hosts = [
                host(folder / f"host{number}", number, options.workers, options.database, store)
                for number in range(options.hosts)
            ]
            settings = Settings(
                _env_file=None,
                data_dir=folder / "reader",
                database_url=options.database,
                object_store=f"s3://{BUCKET}/morph",
            )
            queue = JobQueue(settings)
            queue.migrate()
            started = time.monotonic()
            jobs = [submit(queue, options.frames) for _ in range(options.jobs)]
            try:
                happened = disturb_until_done(queue, hosts, chance, options)
            finally:
                for each in hosts:
                    each.end()
            faults = [fault for job in jobs for fault in faults_of(queue, settings, job, expected)]
            computed = sum(len(frames(settings, job)) for job in jobs)
            print(f"{options.jobs} jobs, {options.hosts} hosts, {time.monotonic() - started:.0f} s")
            print(", ".join(f"{count} {what}" for what, count in happened.most_common()))
            print(f"frames computed again: {computed - options.jobs * options.frames}")
            print("\n".join(faults) or "nothing lost, nothing twice, every result as undisturbed")
            if faults:
                for each in hosts:
                    print((each.folder / "processes.log").read_text()[-2000:])
            queue.close()
    return len(faults)


def host(folder: Path, number: int, workers: int, database: str, store: tuple[str, int]) -> Host:
    """A host whose processes do not run yet."""
    folder.mkdir()
    url = sa.make_url(database)
    links = {
        "database": Link((url.host or "127.0.0.1", url.port or 5432)),
        "store": Link(store),
    }
    near = url.set(host="127.0.0.1", port=links["database"].port)
    own = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
    environment = own | {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{links['store'].port}",
        "MORPH_DATA_DIR": str(folder),
        "MORPH_DATABASE_URL": near.render_as_string(hide_password=False),
        "MORPH_OBJECT_STORE": f"s3://{BUCKET}/morph",
        "MORPH_THREADS": "1",
        "MORPH_WARM_ENGINES": "false",
        "MORPH_POLL_SECONDS": "0.5",
        "MORPH_ATTEMPTS": "10",
    }
    slots = [("run", "--slot", f"{number * workers + slot}") for slot in range(workers)]
    return Host(folder, environment, links, dict.fromkeys([*slots, ("janitor",)]))


def submit(queue: JobQueue, frame_count: int) -> str:
    """Queue a small job."""
    settings = {"method": "joint", "sampling.points_per_cell_edge": 1, "frames": frame_count}
    spec = JobSpec(
        source=BuiltInShape(shape="sphere"),
        target=BuiltInShape(shape="star"),
        config=configure("fast", settings),
        device="cpu",
        timeout_seconds=PATIENCE_SECONDS,
    )
    job = new_id()
    queue.enqueue(spec, job_id=job, owner="")
    return job


def disturb_until_done(
    queue: JobQueue, hosts: list[Host], chance: random.Random, options: argparse.Namespace
) -> Counter[str]:
    """Disturb hosts while jobs run, then let them end; returns what happened."""
    happened: Counter[str] = Counter()
    deadline = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < deadline:
        for each in hosts:
            each.keep_alive()
        counts = queue.counts()
        if not counts[JobState.QUEUED] and not counts[JobState.RUNNING]:
            break
        if sum(happened.values()) < options.faults:
            time.sleep(chance.expovariate(1 / options.interval))
            happened[chance.choice(hosts).disturb(chance)] += 1
        else:
            time.sleep(1)
    return happened


def frames(settings: Settings, job: str) -> list[int]:
    """Frames that were computed, repetitions included."""
    storage = open_storage(settings, "reader")
    storage.fetch(job, log_only=True)
    return [e.data["frame"] for e in storage.events(job).read(limit=10**6) if e.type == "frame"]


def faults_of(queue: JobQueue, settings: Settings, job: str, expected: np.ndarray) -> list[str]:
    """What is wrong with a job."""
    record = queue.get(job)
    if record is None or record.state is not JobState.SUCCEEDED:
        return [f"{job} is {record and record.state.value}: {record and record.problem}"]
    storage = open_storage(settings, "reader")
    storage.fetch(job)
    with Trajectory(storage.result_path(job)) as result:
        same = result.status == "complete" and np.array_equal(np.stack(list(result)), expected)
    return [] if same else [f"{job} differs from an undisturbed run"]


if __name__ == "__main__":
    sys.exit(main())
