"""Keeps processes of the service alive: each starts again when it dies, and ends with this one."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from chamfer_morph.worker.exit_codes import ExitCode
from morph_engine.child_process import describe_exit, python_command

POLL_SECONDS = 0.1
STOP_SECONDS = 8.0
"""Time to end in peace; with the rest it stays under ten seconds."""

STEADY_SECONDS = 5.0
"""Whatever has run for so long is started again at once when it dies."""

FIRST_PAUSE_SECONDS, LONGEST_PAUSE_SECONDS = 0.5, 30.0

_PR_SET_PDEATHSIG = 1


@dataclass
class SupervisedProcess:
    """A process to keep alive.

    Attributes:
        name: What to call it in messages.
        command: Its command line.
        environment: Its environment; None means that of this process.
        inherited: File descriptors that it inherits.
        may_refuse: Whether it is left as it is where its first start ends with ExitCode.REFUSED.
        refused: Whether it has done so.
    """

    name: str
    command: Sequence[str]
    environment: Mapping[str, str] | None = None
    inherited: tuple[int, ...] = ()
    may_refuse: bool = False
    refused: bool = field(default=False, init=False)
    _process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _starts: int = field(default=0, init=False)
    _started_at: float = field(default=0.0, init=False)
    _start_at: float = field(default=0.0, init=False)
    _pause: float = field(default=0.0, init=False)

    def keep_alive(self) -> None:
        """Start it unless it runs: at once, or after a growing pause where it died soon."""
        if self._process is not None:
            status = self._process.poll()
            if status is None:
                return
            self._process = None
            if self.may_refuse and self._starts == 1 and status == ExitCode.REFUSED:
                self.refused = True
                return
            if time.monotonic() - self._started_at >= STEADY_SECONDS:
                self._pause = 0.0
            else:
                self._wait_longer()
            how = describe_exit(status)
            log(f"{self.name} ended ({how}); restarting it in {self._pause:g} s.")
        if time.monotonic() >= self._start_at:
            try:
                self._start()
            except (OSError, subprocess.SubprocessError) as error:
                self._wait_longer()
                log(f"{self.name} cannot be started ({error}); trying again in {self._pause:g} s.")

    def _wait_longer(self) -> None:
        """Make the pause before the next start longer than the last one."""
        longer = max(2 * self._pause, FIRST_PAUSE_SECONDS)
        self._pause = min(longer, LONGEST_PAUSE_SECONDS)
        self._start_at = time.monotonic() + self._pause

    def terminate(self) -> None:
        """Ask it to end, if it runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def wait(self, deadline: float) -> None:
        """Wait for its end; kill it at the deadline, a time of `time.monotonic`."""
        if self._process is None:
            return
        try:
            self._process.wait(max(deadline - time.monotonic(), 0.01))
        except subprocess.TimeoutExpired:
            log(f"{self.name} does not stop and will be killed.")
            self._process.kill()
            self._process.wait()

    def _start(self) -> None:
        """Start it in a session of its own, so that Ctrl-C reaches the supervisor alone."""
        self._started_at = time.monotonic()
        self._process = subprocess.Popen(
            self.command,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            pass_fds=self.inherited,
            start_new_session=True,
            preexec_fn=_die_with_parent(os.getpid()) if sys.platform == "linux" else None,
        )
        self._starts += 1


class StopSignals:
    """Notes SIGTERM and Ctrl-C from now on, which would end the process otherwise.

    Attributes:
        received: Number of the first that came; None while there is none.
    """

    def __init__(self) -> None:
        self.received: int | None = None
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._receive)

    def _receive(self, number: int, _: object) -> None:
        self.received = self.received or number


def worker_slot(
    number: int, environment: Mapping[str, str] | None = None, *, may_refuse: bool = False
) -> SupervisedProcess:
    """The process of a worker slot of this machine."""
    command = python_command("chamfer_morph.worker", "run", "--slot", str(number))
    return SupervisedProcess(f"worker slot {number}", command, environment, may_refuse=may_refuse)


def supervise(
    processes: Sequence[SupervisedProcess],
    stop: StopSignals,
    on_poll: Callable[[], None] = lambda: None,
) -> None:
    """Keep processes alive until a signal comes or one refuses to start, then end them.

    Args:
        processes: The processes, not started yet.
        stop: What ends it.
        on_poll: Called several times a second.
    """
    try:
        while stop.received is None and not any(process.refused for process in processes):
            for process in processes:
                process.keep_alive()
            time.sleep(POLL_SECONDS)
            on_poll()
    finally:
        for process in processes:
            process.terminate()
        deadline = time.monotonic() + STOP_SECONDS
        for process in processes:
            process.wait(deadline)


def log(line: str) -> None:
    """Write a line to standard error."""
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


def _die_with_parent(parent: int) -> Callable[[], None]:
    """What a child does first: ask the kernel for SIGTERM when the supervisor dies."""
    library = ctypes.CDLL(None, use_errno=True)

    def prepare() -> None:
        library.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(1)

    return prepare
