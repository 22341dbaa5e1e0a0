"""`morph serve`: the API, the worker slots and the janitor on this machine, kept alive.

This process holds the listening socket itself, so that callers wait instead of being refused while
the API starts again after a crash.
"""

from __future__ import annotations

import socket
import subprocess
import urllib.error
import urllib.request

from chamfer_morph.server.listener import address, listen
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.supervisor import (
    StopSignals,
    SupervisedProcess,
    log,
    supervise,
    worker_slot,
)
from morph_engine.child_process import python_command

_DIRECTLY = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""Asks this machine, whatever proxy there is for others."""


def serve(settings: Settings) -> int:
    """Run everything until SIGTERM or SIGINT.

    Returns:
        Exit status: 0 after a signal, else that of the check that refused to start.
    """
    stop = StopSignals()
    check = subprocess.run(python_command("chamfer_morph.server", "check"), check=False)
    if check.returncode or stop.received is not None:
        return check.returncode
    with listen(settings) as listener:
        url = address(settings, listener)
        announced = False

        def announce() -> None:
            nonlocal announced
            if not announced and _answers(url):
                announced = True
                log(f"morph serves at {url} (Ctrl-C stops it).")

        supervise(_processes(settings, listener), stop, announce)
    return 0


def _processes(settings: Settings, listener: socket.socket) -> list[SupervisedProcess]:
    descriptor = listener.fileno()
    api = python_command("chamfer_morph.server", "api", "--fd", str(descriptor))
    janitor = python_command("chamfer_morph.worker", "janitor")
    return [
        SupervisedProcess("the API", api, inherited=(descriptor,)),
        *(worker_slot(number) for number in range(settings.workers)),
        SupervisedProcess("the janitor", janitor),
    ]


def _answers(url: str) -> bool:
    """Whether the API answers by now."""
    try:
        with _DIRECTLY.open(f"{url}/livez", timeout=0.5):
            return True
    except (OSError, urllib.error.URLError):
        return False
