"""The engine calls no other host, and neither do the libraries that it loads."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys, threading
calls = []
watched = ("urllib.Request", "socket.getaddrinfo", "socket.connect", "http.client.connect")
sys.addaudithook(lambda event, _: calls.append(event) if event in watched else None)
from morph_engine import backend
backend.start("cpu")
for thread in threading.enumerate():
    if thread is not threading.current_thread():
        thread.join(20)
print(*calls)
"""


def test_starting_the_engine_calls_no_host(tmp_path: Path) -> None:
    """Not even on its first day on a machine, when Taichi would ask for a newer version."""
    usual = {name: value for name, value in os.environ.items() if name != "TI_SKIP_VERSION_CHECK"}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**usual, "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.split() == []
