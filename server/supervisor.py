"""`morph serve`: one process that keeps the API, the worker slots and the janitor alive.

It holds the listening socket itself, so that callers wait instead of being refused while the API
starts again after a crash.
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass, field
from types import FrameType

from chamfer_morph.server.listener import address, listen
from chamfer_morph.worker.settings import Settings

POLL_SECONDS = 0.1
STOP_SECONDS = 8.0
"""Time to end in peace; with the rest it stays under ten seconds."""

STEADY_SECONDS = 5.0
"""Whatever has run for so long is started again at once when it dies."""

FIRST_PAUSE = 0.5
LONGEST_PAUSE = 30.0

_PR_SET_PDEATHSIG = 1


@dataclass
class Child:
    """A process to keep alive.

    Attributes:
        name: What to call it in messages.
        command: Its command line.
        handles: File descriptors that it inherits.
    """

    name: str
    command: list[str]
    handles: tuple[int, ...] = ()
    process: subprocess.Popen[bytes] | None = None
    started_at: float = 0.0
    start_at: float = 0.0
    pause: float = field(default=0.0)

    def start(self) -> None:
        """Start it in a session of its own, so that Ctrl-C reaches the supervisor alone."""
        self.started_at = time.monotonic()
        self.process = subprocess.Popen(
            self.command,
            stdin=subprocess.DEVNULL,
            pass_fds=self.handles,
            start_new_session=True,
            preexec_fn=_die_with_parent(os.getpid()) if sys.platform == "linux" else None,
        )

    def revive(self) -> None:
        """Start it again if it has died, at once or after a pause that grows."""
        if self.process is not None:
            status = self.process.poll()
            if status is None:
                return
            self.process = None
            lived = time.monotonic() - self.started_at
            if lived >= STEADY_SECONDS:
                self.pause = 0.0
            else:
                self.pause = min(max(2 * self.pause, FIRST_PAUSE), LONGEST_PAUSE)
            self.start_at = time.monotonic() + self.pause
            _say(f"{self.name} ended ({_ending(status)}); it starts again in {self.pause:g} s.")
        if time.monotonic() >= self.start_at:
            self.start()

    def signal(self, number: int) -> None:
        """Send a signal, if it is alive."""
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(number)


def serve(settings: Settings) -> int:
    """Run everything until SIGTERM or SIGINT.

    Returns:
        Exit status: 0 after a signal, else that of the check that refused to start.
    """
    stopping: list[int] = []

    def stop(number: int, _: FrameType | None) -> None:
        stopping.append(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    python = sys.executable
    status = subprocess.run([python, "-m", "chamfer_morph.server", "check"], check=False).returncode
    if status or stopping:
        return status
    listener = listen(settings)
    children = [_api(listener), *_workers(settings.workers)]
    try:
        for child in children:
            child.start()
        announced = False
        while not stopping:
            time.sleep(POLL_SECONDS)
            for child in children:
                child.revive()
            if not announced and _answers(settings, listener):
                announced = True
                _say(f"morph serves at {address(settings, listener)} (Ctrl-C stops it).")
    finally:
        _stop(children)
        listener.close()
    return 0


def _api(listener: socket.socket) -> Child:
    handle = listener.fileno()
    command = [sys.executable, "-m", "chamfer_morph.server", "api", "--fd", str(handle)]
    return Child("the API", command, (handle,))


def _workers(slots: int) -> list[Child]:
    python = sys.executable
    janitor = Child("the janitor", [python, "-m", "chamfer_morph.worker", "janitor"])
    return [
        *(
            Child(
                f"worker slot {slot}",
                [python, "-m", "chamfer_morph.worker", "run", "--slot", str(slot)],
            )
            for slot in range(slots)
        ),
        janitor,
    ]


def _stop(children: list[Child]) -> None:
    """Ask all to end; kill those that have not after a while."""
    for child in children:
        child.signal(signal.SIGTERM)
    deadline = time.monotonic() + STOP_SECONDS
    for child in children:
        if child.process is None:
            continue
        try:
            child.process.wait(max(deadline - time.monotonic(), 0.01))
        except subprocess.TimeoutExpired:
            _say(f"{child.name} does not end and is killed.")
            child.process.kill()
            child.process.wait()


def _answers(settings: Settings, listener: socket.socket) -> bool:
    """Whether the API answers by now."""
    try:
        with urllib.request.urlopen(f"{address(settings, listener)}/livez", timeout=0.5):
            return True
    except (OSError, urllib.error.URLError):
        return False


def _die_with_parent(parent: int) -> Callable[[], None]:
    """What a child does first: ask the kernel for SIGTERM when the supervisor dies."""
    library = ctypes.CDLL(None, use_errno=True)

    def prepare() -> None:
        library.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(1)

    return prepare


def _ending(status: int) -> str:
    return signal.Signals(-status).name if status < 0 else f"exit status {status}"


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()
