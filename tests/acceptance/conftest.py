"""Real workers, janitors and engine processes to be killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
import pytest

from chamfer_morph.schemas import BuiltInShape, JobState, Shape
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.slots import WorkerSlots
from chamfer_morph.worker.storage import open_storage
from morph_engine.presets import configure
from morph_engine.results.trajectory import Trajectory
from tests.patience import PATIENCE

SPHERE = BuiltInShape(shape="sphere")

POSTGRES_BY_FAULT_TESTS = pytest.mark.parametrize(
    "database_url", ["sqlite", pytest.param("postgres", marks=pytest.mark.faults)], indirect=True
)
"""For tests whose way through Postgres is another's, too: there by `make test-faults` alone."""

FRAMES = 30
"""Frames of a small job; each takes about a tenth of a second."""


@dataclass
class Cluster:
    """Workers and janitors on one data directory and one database.

    Attributes:
        settings: Of all its processes.
        environment: The same as variables.
        processes: Everything that was started.
    """

    settings: Settings
    environment: dict[str, str]
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Make the tables."""
        self.storage = open_storage(self.settings, "test")
        self.queue = JobQueue(self.settings)
        self.queue.migrate()
        self.database = database(self.settings)
        self.slots = WorkerSlots(self.database)

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[bytes]:
        """Start a process of the worker room."""
        return self._start(["-m", "chamfer_morph.worker", *arguments], environment)

    def program(self, code: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Start a program with the settings of the cluster."""
        return self._start(["-c", code, *arguments], {})

    def _start(self, command: list[str], environment: dict[str, str]) -> subprocess.Popen[bytes]:
        with (self.settings.data_dir / "processes.log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, *command],
                env=self.environment | environment,
                stderr=log,
            )
        self.processes.append(process)
        return process

    def worker(self, slot: int = 0, **environment: str) -> subprocess.Popen[bytes]:
        """Start a worker slot."""
        return self.start("run", "--slot", str(slot), **environment)

    def submit(
        self,
        *,
        frames: int = FRAMES,
        owner: str = "",
        timeout: float = 86400,
        priority: int = 100,
        precision: str = "float32",
        source: Shape = SPHERE,
        states_every: int = 0,
    ) -> str:
        """Queue a small job whose frames take a while."""
        settings = {"method": "joint", "sampling.points_per_cell_edge": 1, "frames": frames}
        config = configure("fast", settings | {"precision": precision})
        spec = JobSpec(
            source=source,
            target=BuiltInShape(shape="star"),
            config=config,
            device="cpu",
            timeout_seconds=timeout,
            states_every=states_every,
        )
        job_id = new_id()
        assert self.queue.enqueue(spec, job_id=job_id, owner=owner, priority=priority)
        return job_id

    def job(self, job_id: str) -> JobRecord:
        """A job as it stands."""
        record = self.queue.get(job_id)
        assert record is not None
        return record

    def frames(self, job_id: str) -> list[int]:
        """Indices of the frames that were computed, in order, repetitions included."""
        self.storage.fetch(job_id, log_only=True)
        events = self.storage.events(job_id).read()
        return [event.data["frame"] for event in events if event.type == "frame"]

    def wait_until(
        self, condition: Callable[[], bool], what: str, seconds: float = PATIENCE
    ) -> float:
        """Wait for a condition; returns how long it took [s]."""
        start = time.monotonic()
        while not condition():
            if time.monotonic() - start > seconds:
                log = (self.settings.data_dir / "processes.log").read_text(errors="replace")
                pytest.fail(f"{what}: not within {seconds} s.\n{log[-3000:]}")
            time.sleep(0.02)
        return time.monotonic() - start

    def wait_for_frame(self, job_id: str, frame: int) -> None:
        """Wait until a frame is finished; a job that ends without it is not waited for."""

        def there_or_ended() -> bool:
            ended = self.job(job_id).state.finished
            return frame in self.frames(job_id) or ended

        self.wait_until(there_or_ended, f"frame {frame} of {job_id}")
        assert frame in self.frames(job_id), self.job(job_id).problem

    def wait_for_state(
        self, job_id: str, *states: JobState, seconds: float = PATIENCE
    ) -> JobRecord:
        """Wait until a job is in one of some states."""
        self.wait_until(lambda: self.job(job_id).state in states, f"{job_id} in {states}", seconds)
        return self.job(job_id)

    def engine(self, worker: subprocess.Popen[bytes]) -> psutil.Process:
        """The engine process of the job that a worker computes."""
        self.wait_until(lambda: bool(self.engines(worker)), "the engine process of a worker")
        return self.engines(worker)[0]

    def engines(self, worker: subprocess.Popen[bytes]) -> list[psutil.Process]:
        """Engine processes of a worker that have a job."""
        return [engine for engine in _engine_processes(worker) if self._has_job(engine)]

    def spare(self, worker: subprocess.Popen[bytes]) -> psutil.Process | None:
        """The engine process of a worker that waits for a job, if there is one."""
        spares = (engine for engine in _engine_processes(worker) if not self._has_job(engine))
        return next(spares, None)

    def _has_job(self, engine: psutil.Process) -> bool:
        """It writes its messages into the directory of its job."""
        with suppress(psutil.Error):  # it has ended
            return any("/jobs/" in file.path for file in engine.open_files())
        return False

    def require_sound(self, job_id: str, undisturbed: np.ndarray, *, kills: int = 1) -> None:
        """A succeeded job: its result equals an undisturbed one, and little was done twice."""
        self.wait_until(lambda: self.job(job_id).state.finished, f"{job_id} has finished")
        record = self.job(job_id)
        assert record.state is JobState.SUCCEEDED, record.problem
        self.storage.fetch(job_id)
        with Trajectory(self.storage.result_path(job_id)) as result:
            assert result.status == "complete"
            positions = np.stack(list(result))
        np.testing.assert_array_equal(positions, undisturbed)
        frames = self.frames(job_id)
        assert set(frames) == set(range(FRAMES))
        assert len(frames) - FRAMES <= kills
        assert record.outcome is not None
        assert record.outcome.frames == FRAMES

    def close(self) -> None:
        """Kill everything."""
        for process in self.processes:
            if process.poll() is None:
                family = psutil.Process(process.pid).children(recursive=True)
                process.kill()
                for member in family:
                    with_patience(member)
            process.wait()
        self.queue.close()
        self.database.dispose()


def _engine_processes(worker: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """The engine processes of a worker, which has other short-lived children too."""
    found = []
    for child in psutil.Process(worker.pid).children():
        with suppress(psutil.Error):  # it has ended
            if "chamfer_morph.worker.engine_process" in child.cmdline():
                found.append(child)
    return found


def with_patience(process: psutil.Process) -> None:
    """Kill a process that may be gone already."""
    try:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait(PATIENCE)
    except psutil.Error:
        pass


@pytest.fixture
def new_cluster(tmp_path: Path) -> Iterator[Callable[..., Cluster]]:
    """Makes an empty cluster on the database of a URL, with data in a folder."""
    made: list[Cluster] = []

    def make(database_url: str, data_dir: Path | None = None, **changes: str) -> Cluster:
        folder = data_dir or tmp_path / f"data{len(made)}"
        made.append(make_cluster(folder, database_url, **changes))
        return made[-1]

    yield make
    for cluster in made:
        cluster.close()


@pytest.fixture
def cluster(new_cluster: Callable[..., Cluster], database_url: str) -> Cluster:
    """An empty cluster, on SQLite and on Postgres."""
    return new_cluster(database_url)


def make_cluster(data_dir: Path, database_url: str, **changes: str) -> Cluster:
    """A cluster without processes, quick to notice things, without spare engines, but for changes
    of its settings.
    """  # noqa: D205
    values = {
        "data_dir": str(data_dir),
        "database_url": database_url,
        "poll_seconds": "0.1",
        "retry_seconds": "0.2",
        "adoption_seconds": "0.5",
        "threads": "1",
        "warm_engines": "false",
    } | changes
    own = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
    variables = {f"MORPH_{name.upper()}": value for name, value in values.items()}
    return Cluster(Settings(_env_file=None, **values), own | variables)


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Positions of a small job that nothing disturbed, shape [frames, n, 3]."""
    out = tmp_path_factory.mktemp("undisturbed") / "result.vtkhdf"
    subprocess.run(
        [sys.executable, "-m", "chamfer_morph", "run", "sphere", "star", "--method", "joint",
         "--points-per-cell-edge", "1",
         "--frames", str(FRAMES), "--device", "cpu", "--out", out, "--quiet"],
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    with Trajectory(out) as result:
        return np.stack(list(result))
