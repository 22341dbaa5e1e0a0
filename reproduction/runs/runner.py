"""Many runs on this machine: a process each, some at a time, and how far they have come.

Nothing is lost when this process or any of its runs is killed: finished runs are in the store and
unfinished ones in their run directories.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from chamfer_morph.reproduction.meshes import MeshFolder
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.store import Record, Store
from chamfer_morph.reproduction.runs.version_0_1 import find_old_record
from morph_engine.child_process import python_command
from morph_engine.machine_cores import usable_cores
from morph_engine.results.spool import finished_frames

POLL_SECONDS = 0.2
LOG_TAIL_BYTES = 600
MEMORY_PER_RUN = 1e9
"""What a run may take [bytes], generously."""


@dataclass
class Progress:
    """How far a list of runs has come.

    Attributes:
        runs: All runs to be computed.
        finished: Records of those that are over, by id.
        frames: Finished frames of those under way, by id.
    """

    runs: Sequence[Run]
    finished: dict[str, Record] = field(default_factory=dict)
    frames: dict[str, int] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """Expected cost of all runs [CPU s]."""
        return sum(run.expected_cpu_seconds for run in self.runs)

    @property
    def cost_done(self) -> float:
        """The part of it that is over [CPU s]."""
        return sum(run.expected_cpu_seconds * self._share(run) for run in self.runs)

    def _share(self, run: Run) -> float:
        if run.id in self.finished:
            return 1.0
        return self.frames.get(run.id, 0) / run.frames


ProgressCallback = Callable[[Progress], None]


def default_jobs() -> int:
    """Runs at the same time that suit this machine: one a core, if memory allows."""
    memory = int(psutil.virtual_memory().available // MEMORY_PER_RUN)
    return max(1, min(usable_cores(), memory))


def known_records(
    runs: Sequence[Run], store: Store, meshes: MeshFolder, *, any_code: bool = False
) -> dict[str, Record]:
    """Records of the runs that need not be computed again, by id.

    These are runs that today's code has computed, or with `any_code` other code, or code that
    their records do not name.

    Raises:
        MorphError: A mesh is missing or a setting unknown.
    """
    found = {
        run.id: store.find(run, run.digest(meshes)) or find_old_record(run, store, meshes)
        for run in runs
    }
    return {
        run_id: record
        for run_id, record in found.items()
        if record and (any_code or record.provenance.code == record.run.code)
    }


def execute(
    runs: Sequence[Run],
    store: Store,
    meshes: MeshFolder,
    *,
    jobs: int,
    any_code: bool = False,
    on_progress: ProgressCallback = lambda progress: None,
) -> dict[str, Record]:
    """Compute runs that are not in the store yet (see `known_records`), the costly ones first.

    So many jobs at a time share the cores; progress is reported several times a second. Returns
    the records of all runs by id, failed ones included.

    Raises:
        MorphError: A mesh is missing or a setting unknown; nothing has been computed then.
    """
    known = known_records(runs, store, meshes, any_code=any_code)
    missing = [run for run in runs if run.id not in known]
    waiting = sorted(missing, key=lambda run: run.expected_cpu_seconds)  # taken from the end
    threads = max(1, usable_cores() // jobs)
    progress = Progress(missing)
    active: dict[str, tuple[Run, subprocess.Popen[bytes]]] = {}
    try:
        while waiting or active:
            while waiting and len(active) < jobs:
                run = waiting.pop()
                active[run.id] = run, _start(run, store, meshes, threads)
            time.sleep(POLL_SECONDS)
            for run, process in list(active.values()):
                # the run directory goes when the run is over
                frames = finished_frames(store.result_path(run))
                progress.frames[run.id] = max(frames, progress.frames.get(run.id, 0))
                if process.poll() is not None:
                    del active[run.id], progress.frames[run.id]
                    progress.finished[run.id] = _record(run, run.digest(meshes), store, process)
            on_progress(progress)
    finally:
        for _, process in active.values():
            process.kill()
            process.wait()
    return known | progress.finished


def _start(run: Run, store: Store, meshes: MeshFolder, threads: int) -> subprocess.Popen[bytes]:
    digest = run.digest(meshes)
    # so that what is there later is of this attempt, or of one that it goes on with
    store.save_progress(run, digest, store.progress(run, digest))
    arguments = [run.model_dump_json(), str(store.folder), str(meshes.path), str(threads)]
    with store.log_path(run).open("wb") as log:
        return subprocess.Popen(
            python_command("chamfer_morph.reproduction.runs.run_process", *arguments),
            stdin=subprocess.PIPE,  # its end tells the process that we are gone
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C is ours alone
        )


def _record(run: Run, digest: str, store: Store, process: subprocess.Popen[bytes]) -> Record:
    """What a process that has ended left behind."""
    if process.stdin:
        process.stdin.close()
    record = store.read(run, digest)
    if record is not None and record.status != "unfinished":
        if record.is_complete:
            store.log_path(run).unlink(missing_ok=True)
        return record
    status = process.returncode
    end = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
    return store.save_failure(
        run, digest, f"Its process {end}. {_last_log_line(store.log_path(run))}".strip()
    )


def _last_log_line(log: Path) -> str:
    try:
        text = log.read_bytes()[-LOG_TAIL_BYTES:].decode(errors="replace").strip()
    except OSError:
        return ""
    return text.splitlines()[-1] if text else ""
