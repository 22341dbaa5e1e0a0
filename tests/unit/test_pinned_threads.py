"""Where Taichi's threads run."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

STARTED = """
import json, os, sys
import numpy as np
import taichi as ti
from morph_engine import backend

backend.start("cpu", threads=int(sys.argv[1]))

@ti.kernel
def work(x: ti.types.ndarray()):
    for i in range(x.shape[0]):
        for _ in range(200):
            x[i] = ti.sin(x[i] + 1)

values = backend.active().upload(np.zeros(400_000))
for _ in range(4):
    work(values)
tasks = {}
for task in os.listdir("/proc/self/task"):
    with open(f"/proc/self/task/{task}/stat") as file:
        ticks = int(file.read().rpartition(")")[2].split()[11])
    tasks[task] = [ticks, sorted(os.sched_getaffinity(int(task)))]
tasks.pop(str(os.getpid()))
print(json.dumps(tasks))
"""


def started(threads: int, folder: Path) -> list[tuple[int, list[int]]]:
    """Of the threads of a process in which kernels ran: ticks taken, and cores they may use."""
    script = folder / "started.py"
    script.write_text(STARTED, encoding="utf-8")
    command = [sys.executable, str(script), str(threads)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [(ticks, cores) for ticks, cores in json.loads(done.stdout).values()]


@pytest.mark.skipif(sys.platform != "linux", reason="threads are pinned on Linux alone")
def test_where_all_cores_compute_each_has_a_thread_of_its_own(tmp_path: Path) -> None:
    """The threads that computed are those that are pinned."""
    usable = sorted(os.sched_getaffinity(0))
    if len(usable) == 1:
        pytest.skip("there is one core")
    threads = sorted(started(0, tmp_path))
    computing = threads[-len(usable) :]
    assert sorted(core for _, cores in computing for core in cores) == usable
    assert all(ticks > 0 for ticks, _ in computing)
    assert all(cores == usable for _, cores in threads[: -len(usable)])


@pytest.mark.skipif(sys.platform != "linux", reason="threads are pinned on Linux alone")
def test_a_process_with_fewer_threads_than_cores_leaves_them_alone(tmp_path: Path) -> None:
    """Others compute on the same machine."""
    usable = sorted(os.sched_getaffinity(0))
    if len(usable) == 1:
        pytest.skip("there is one core")
    assert all(cores == usable for _, cores in started(len(usable) - 1, tmp_path))
