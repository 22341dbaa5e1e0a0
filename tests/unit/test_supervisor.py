"""Processes that are kept alive."""

from __future__ import annotations

import sys
from types import SimpleNamespace

from chamfer_morph.worker.supervisor import SupervisedProcess, supervise


def test_a_process_that_cannot_be_started_ends_no_other(capsys) -> None:
    """As where there are no more processes to be had: it is tried again, and the others go on."""
    steady = SupervisedProcess("steady", [sys.executable, "-c", "import time; time.sleep(600)"])
    missing = SupervisedProcess("missing", ["/nowhere/at-all"])
    stop = SimpleNamespace(received=None)
    looks = []

    def look() -> None:
        assert steady._process is not None and steady._process.poll() is None
        looks.append(missing._process)
        stop.received = 15 if len(looks) == 5 else None

    supervise([missing, steady], stop, look)  # type: ignore[arg-type]
    assert looks == [None] * 5
    assert steady._process is not None and steady._process.poll() is not None
    assert "missing cannot be started" in capsys.readouterr().err
