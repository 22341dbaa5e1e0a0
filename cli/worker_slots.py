"""Worker processes of this machine: one a slot, started again when one dies."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from morph_engine.errors import ConfigError, DeviceError

LOOK_SECONDS = 0.2
FIRST_PAUSE_SECONDS, LONGEST_PAUSE_SECONDS = 1.0, 30.0
STEADY_SECONDS = 30.0
"""A worker that has lived for so long has not died of its start."""

PATIENCE_SECONDS = 10.0
"""How long workers have to end before they are killed."""

_PR_SET_PDEATHSIG = 1


@dataclass
class Slot:
    """One worker process.

    Attributes:
        number: Its number on this machine.
        environment: Its environment.
    """

    number: int
    environment: Mapping[str, str]
    _process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _started: float = field(default=0.0, init=False)
    _not_before: float = field(default=0.0, init=False)
    _pause: float = field(default=FIRST_PAUSE_SECONDS, init=False)

    def start_if_due(self) -> None:
        """Start the process unless it runs or died a moment ago."""
        if self._process is not None or time.monotonic() < self._not_before:
            return
        self._started = time.monotonic()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "chamfer_morph.worker", "run", "--slot", str(self.number)],
            env=self.environment,
            start_new_session=True,  # Ctrl-C reaches it through us alone
            preexec_fn=_end_with(os.getpid()) if sys.platform == "linux" else None,
        )

    def notice_death(self) -> None:
        """If the process has died, plan its next start."""
        if self._process is None or self._process.poll() is None:
            return
        steady = time.monotonic() - self._started > STEADY_SECONDS
        self._pause = FIRST_PAUSE_SECONDS if steady else self._pause
        sys.stderr.write(
            f"Worker slot {self.number} ended with {self._process.returncode}; "
            f"it starts again in {self._pause:g} s.\n"
        )
        self._not_before = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, LONGEST_PAUSE_SECONDS)
        self._process = None

    def signal(self, number: int) -> None:
        """Send the process a signal, if it runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)

    def wait(self, deadline: float) -> None:
        """Wait for the end of the process; kill it at the deadline."""
        if self._process is None:
            return
        try:
            self._process.wait(max(deadline - time.monotonic(), 0))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _end_with(parent: int) -> Callable[[], None]:
    """What a worker does first: have the kernel send it SIGTERM when its parent dies."""
    library = ctypes.CDLL(None)

    def prepare() -> None:
        library.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(1)

    return prepare


def keep_running(slots: Sequence[Slot]) -> int:
    """Keep workers running until SIGTERM or Ctrl-C, which end them too.

    Returns:
        Exit status: 0 after SIGTERM, 130 after Ctrl-C.
    """
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: received.append(number))
    while not received:
        for slot in slots:
            slot.notice_death()
            slot.start_if_due()
        time.sleep(LOOK_SECONDS)
    for slot in slots:
        slot.signal(signal.SIGTERM)
    deadline = time.monotonic() + PATIENCE_SECONDS
    for slot in slots:
        slot.wait(deadline)
    return 130 if received[0] == signal.SIGINT else 0


def chosen_gpus(text: str) -> list[str]:
    """Indices of GPUs from `all` or a list such as `0,2`.

    Raises:
        ConfigError: It is neither.
        DeviceError: There is no GPU to be found.
    """
    if text != "all":
        indices = text.split(",")
        if not all(index.isdecimal() for index in indices):
            raise ConfigError(f"--gpus {text} names no GPUs.", "Write all, or indices as in 0,2.")
        return list(dict.fromkeys(indices))
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None and all(index.isdecimal() for index in visible.split(",")):
        return visible.split(",")
    try:
        listed = subprocess.run(
            ["nvidia-smi", "--query-gpu=index", "--format=csv,noheader"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
    except (OSError, subprocess.CalledProcessError):
        listed = []
    if not listed:
        raise DeviceError("No NVIDIA GPU is to be found here.", "Use --slots for the CPU.")
    return listed
