"""How many cores a process may use."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from morph_engine.machine_cores import usable_cores

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="affinity and groups of Linux")

ONE_CORE = """
import os
from morph_engine.machine_cores import usable_cores
os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
print(usable_cores())
"""


def test_a_process_has_the_cores_it_may_run_on(tmp_path: Path) -> None:
    """As Slurm and `taskset` give them."""
    assert usable_cores(tmp_path) == len(os.sched_getaffinity(0))
    told = subprocess.run([sys.executable, "-c", ONE_CORE], capture_output=True, check=True)
    assert int(told.stdout) == 1


@pytest.mark.parametrize(
    ("membership", "files"),
    [
        ("0::/jobs/one\n", {"jobs/cpu.max": "max 100000", "jobs/one/cpu.max": "80000 100000"}),
        ("0::/jobs/one\n", {"jobs/cpu.max": "80000 100000", "jobs/one/cpu.max": "max 100000"}),
        (
            "3:memory:/jobs\n2:cpu,cpuacct:/jobs\n0::/\n",
            {"cpu/jobs/cpu.cfs_quota_us": "80000", "cpu/jobs/cpu.cfs_period_us": "100000"},
        ),
        ("0::/../other\n", {"cpu.max": "80000 100000"}),
    ],
)
def test_a_quota_counts(tmp_path: Path, membership: str, files: dict[str, str]) -> None:
    """Of its own control group or one around it, in both versions; a part of a core is one."""
    _write(tmp_path / "proc/self/cgroup", membership)
    for name, text in files.items():
        _write(tmp_path / "sys/fs/cgroup" / name, f"{text}\n")
    assert usable_cores(tmp_path) == 1


def test_no_quota_is_no_limit(tmp_path: Path) -> None:
    """Nor is one of more cores than there are."""
    _write(tmp_path / "proc/self/cgroup", "2:cpu:/one\n0::/one\n")
    group = tmp_path / "sys/fs/cgroup"
    _write(group / "cpu/one/cpu.cfs_quota_us", "-1\n")
    _write(group / "cpu/one/cpu.cfs_period_us", "100000\n")
    _write(group / "one/cpu.max", "900000000 100000\n")
    assert usable_cores(tmp_path) == len(os.sched_getaffinity(0))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
