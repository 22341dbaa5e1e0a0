"""Processes that are kept alive."""

from __future__ import annotations

import sys
from pathlib import Path
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


REFUSING = """
import pathlib, sys
starts = pathlib.Path(sys.argv[1])
starts.open("a").write(".")
sys.exit(2 if len(starts.read_text()) == int(sys.argv[2]) else 1)
"""
"""Ends with a status that tells that it cannot start, at one of its starts, and with 1 else."""


def test_only_a_first_start_may_refuse(tmp_path: Path) -> None:
    """A wrong setting ends all of them; what comes later, such as a lost disk, may heal."""
    for refusing, starts in ((1, 1), (2, 3)):
        counted = tmp_path / f"{refusing}"
        command = [sys.executable, "-c", REFUSING, str(counted), str(refusing)]
        process = SupervisedProcess("one", command, may_refuse=True)
        stop = SimpleNamespace(received=None)

        def look(counted: Path = counted, stop: SimpleNamespace = stop) -> None:
            if counted.exists() and len(counted.read_text()) == 3:
                stop.received = 15

        supervise([process], stop, look)  # type: ignore[arg-type]
        assert len(counted.read_text()) == starts
        assert process.refused == (refusing == 1)
