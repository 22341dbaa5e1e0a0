"""The script for Slurm's arrays starts a worker with what a task is given."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from chamfer_morph.worker.slots import executor_id
from tests.patience import PATIENCE

SCRIPT = Path(__file__).resolve().parents[2] / "docker" / "slurm" / "morph-workers.sbatch"

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Slurm is of POSIX")

SRUN = """#!/bin/sh
while [ "${1#--}" != "$1" ]; do shift; done
exec "$@"
"""
"""Slurm's own runs a command as it is, too, after its options."""


def test_options_come_first() -> None:
    """Slurm reads them as far as the first command; the task has cores, memory and an end."""
    lines = SCRIPT.read_text(encoding="utf-8").splitlines()
    begin = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    options = [line.split()[1] for line in lines if line.startswith("#SBATCH ")]
    assert options == [line.split()[1] for line in lines[:begin] if line.startswith("#SBATCH ")]
    names = {option.partition("=")[0] for option in options}
    assert names >= {"--array", "--cpus-per-task", "--mem", "--time"}


def test_a_task_works_until_it_is_ended(tmp_path: Path) -> None:
    """Under the number of its task, in a folder of its own, which goes with it."""
    programs, home, scratch = tmp_path / "bin", tmp_path / "home", tmp_path / "scratch"
    for folder in (programs, home / "morph" / "bin", home / ".config" / "morph", scratch):
        folder.mkdir(parents=True)
    (home / ".config" / "morph" / "morph.env").write_text("MORPH_WARM_ENGINES=false\n")
    morph = f'#!/bin/sh\nexec "{sys.executable}" -m chamfer_morph "$@"\n'
    for path, text in ((programs / "srun", SRUN), (home / "morph" / "bin" / "morph", morph)):
        path.write_text(text)
        path.chmod(0o755)
    own = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
    own |= {"HOME": str(home), "TMPDIR": str(scratch), "PATH": f"{programs}:{own['PATH']}"}
    own |= {"SLURM_CPUS_PER_TASK": "2", "SLURM_ARRAY_TASK_ID": "7"}
    task = subprocess.Popen(["sh", SCRIPT], env=own)
    try:
        wait_for(lambda: [*scratch.glob(f"morph-*/locks/{executor_id(7)}.alive")])
        (supervisor,) = psutil.Process(task.pid).children()
        assert supervisor.environ()["MORPH_THREADS"] == "2"
        supervisor.send_signal(signal.SIGTERM)
        task.wait(PATIENCE)
    finally:
        if task.poll() is None:
            for process in [*psutil.Process(task.pid).children(recursive=True), task]:
                process.kill()
            task.wait()
    assert not [*scratch.iterdir()]


def wait_for(condition) -> None:
    """Wait until something is there."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
