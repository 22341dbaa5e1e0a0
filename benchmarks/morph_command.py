"""Rows on the `morph` command, each in a fresh process: cold start, memory, a whole job."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.comparison import Row, limit
from morph_engine.results.spool import spool_path

GIGABYTE = 1e9
KILOBYTE = 1 if sys.platform == "darwin" else 1024  # unit of ru_maxrss


@dataclass(frozen=True)
class Run:
    """What a run of the command took.

    Attributes:
        first_frame: Wall-clock time until the first frame was safe on disk [s].
        wall: Wall-clock time [s].
        cpu: CPU time, summed over threads [s].
        memory: Peak resident memory [GB].
    """

    first_frame: float
    wall: float
    cpu: float
    memory: float


def measure(quick: bool) -> list[Row]:
    """Run the command and watch it from outside; the whole job only in the full benchmark."""
    chamfer = ["--set=chamfer.start_frame=0", "--set=chamfer.ramp_frames=1"]
    short = ["--method=joint", "--frames=2", *chamfer]
    with tempfile.TemporaryDirectory() as cache:
        cold = run(["--method=joint", "--frames=1"], caches_in(cache))
    with tempfile.TemporaryDirectory() as cache:
        first, again = (run([], caches_in(cache)) for _ in range(2))
    usual, fine = warm_run(short), run([*short, "--points-per-cell-edge=4"])
    rows = [
        limit("cold start to the first frame", cold.first_frame, "s", 20, 8, "nothing compiled"),
        limit("warm start to the first frame", usual.first_frame, "s"),
        limit("flow: cold start to the first frame", first.first_frame, "s", 8, 5, "of 40"),
        limit("flow: warm start to the first frame", again.first_frame, "s", 2, 1.2, "of 40"),
        limit("memory, 37k particles", usual.memory, "GB", 0.6, 0.4),
        limit("memory, 88k particles", fine.memory, "GB", 1.0, 0.6),
    ]
    if not quick:
        for method, bar in (("flow", (6, 3)), ("joint", (180, 45)), ("transport", (180, 45))):
            job = warm_run([f"--method={method}"])
            what, note = f"whole {method} job, 40 frames", f"{job.cpu:.0f} CPU s, caches warm"
            rows.append(limit(what, job.wall, "s", *bar, note))
    return rows


def caches_in(folder: str) -> dict[str, str]:
    """The environment in which kernels and kept results are looked for in a folder."""
    return {"TI_OFFLINE_CACHE_FILE_PATH": folder, "XDG_CACHE_HOME": folder}


def warm_run(options: list[str]) -> Run:
    """Run it when its kernels are in the cache, whatever the cache held before."""
    run([*options, "--frames=2"])
    return run(options)


def run(options: list[str], environment: dict[str, str] | None = None) -> Run:
    """Run `morph run sphere torus` to its end.

    Raises:
        RuntimeError: The command failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "morph.vtkhdf"
        first_file = spool_path(out) / "frame-000000.npz"
        arguments = ["run", "sphere", "torus", f"--out={out}", "--device=cpu", "--quiet", *options]
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "chamfer_morph", *arguments],
            stdout=subprocess.DEVNULL,
            env={**os.environ, **(environment or {})},
        )
        first_frame = None
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            now = time.perf_counter() - start
            if first_frame is None and (pid or first_file.exists()):
                first_frame = now
            if pid:
                break
            time.sleep(0.02)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"morph {' '.join(arguments)} ended with {process.returncode}")
    return Run(
        first_frame=first_frame,
        wall=now,
        cpu=usage.ru_utime + usage.ru_stime,
        memory=usage.ru_maxrss * KILOBYTE / GIGABYTE,
    )
