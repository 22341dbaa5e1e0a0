"""Where a run's numbers come from: by which code, on which machine, when and at which cost.

This stands beside a result and never in it, so that equal runs leave equal files.
"""

from __future__ import annotations

import os
import platform
import subprocess
import time
from datetime import datetime, timezone
from functools import cache
from pathlib import Path

import psutil
from pydantic import BaseModel, Field

from morph_engine import backend
from morph_engine.code_digest import code_digest
from morph_engine.machine_cores import usable_cores


class Provenance(BaseModel, frozen=True):
    """How a run was computed, beside the versions of software that its record names.

    A run that was interrupted has the times of all its parts together, and the machine and the date
    of the last one. What nobody noted is empty.
    """

    code: str = Field("", description="SHA-256 of the code that computed it, see `code_digest`.")
    commit: str = Field(
        "",
        description="Commit of the checkout, with -dirty if files were modified; empty without a "
        "checkout.",
    )
    device: str = Field("", description="cpu, cuda, vulkan or metal.")
    cpu: str = Field("", description="Name of the processor.")
    gpu: str = Field("", description="Name of the NVIDIA GPU, if one was used.")
    threads: int = Field(0, description="Threads on the CPU.")
    date: datetime | None = Field(None, description="Time when it ended, in UTC.")
    wall_seconds: float = Field(0.0, description="Wall-clock time [s].")
    cpu_seconds: float = Field(0.0, description="CPU time, summed over threads [s].")

    def after(self, earlier: Provenance) -> Provenance:
        """That of the whole run, where this is its last part, and other parts came before it."""
        seconds = {
            name: round(getattr(self, name) + getattr(earlier, name), 2)
            for name in ("wall_seconds", "cpu_seconds")
        }
        return self.model_copy(update=seconds)


def provenance_by_now(method: str) -> Provenance:
    """Of what this process has computed since it was started, a run of a method.

    Raises:
        ConfigError: There is no such method.
    """
    running = backend.active()
    return Provenance(
        code=code_digest(method),
        commit=commit(),
        device=running.device,
        cpu=cpu_name(),
        gpu=gpu_name() if running.device == "cuda" else "",
        threads=running.threads or usable_cores(),
        date=datetime.now(timezone.utc).replace(microsecond=0),
        wall_seconds=round(time.time() - psutil.Process().create_time(), 2),
        cpu_seconds=round(time.process_time(), 2),
    )


@cache
def commit() -> str:
    """The git commit of this package, with -dirty if files differ from it; empty if there is none.

    A package that lies in a repository without being a part of it has none.
    """
    describe = ("describe", "--always", "--abbrev=40", "--exclude=*", "--dirty")
    return _said("git", *describe) if _said("git", "ls-files", Path(__file__).name) else ""


@cache
def cpu_name() -> str:
    """Name of this machine's processor, as its maker calls it where the system tells."""
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as lines:
            return next(line.split(":")[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


@cache
def gpu_name() -> str:
    """Name of the NVIDIA GPU that CUDA takes first; empty if the driver does not tell."""
    first = os.environ.get("CUDA_VISIBLE_DEVICES", "").partition(",")[0] or "0"
    return _said("nvidia-smi", "--query-gpu=name", "--format=csv,noheader", f"--id={first}")


def _said(*command: str) -> str:
    """What a program prints when it runs in this file's folder; empty if it fails or is absent."""
    folder = Path(__file__).parent
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()
