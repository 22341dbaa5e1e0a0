"""Children with little memory and time: the limits hold, and no child outlives its parent."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from chamfer_morph.worker import sandbox
from chamfer_morph.worker.sandbox import Limits

CHILD = """
import sys
from chamfer_morph.worker import sandbox
from chamfer_morph.worker.exit_codes import ExitCode
sandbox.enter()
try:
    exec(sys.argv[1])
except MemoryError:
    sys.exit(ExitCode.OUT_OF_MEMORY)
"""
PARENT = """
from chamfer_morph.worker import sandbox
sandbox.run("child", ["while True: pass"], sandbox.Limits(1 << 28, 60),
            meet=lambda process: print(process.pid, flush=True))
"""


@pytest.fixture(autouse=True)
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that runs what it is told within its limits."""
    (tmp_path / "child.py").write_text(CHILD)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


def test_what_a_child_prints_is_its_answer() -> None:
    """As a whole, or line by line."""
    code = "print('one'); print('two')"
    assert sandbox.run("child", [code], Limits(1 << 28, 10)).split() == [b"one", b"two"]
    heard: list[bytes] = []
    assert sandbox.run("child", [code], Limits(1 << 28, 10), hear=heard.append) == b""
    assert heard == [b"one\n", b"two\n"]


@pytest.mark.parametrize(
    ("code", "error"),
    [
        ("bytearray(1 << 30)", sandbox.TooMuchMemory),
        ("while True: pass", sandbox.TooMuchTime),
        ("f = open('large', 'wb'); f.write(b'0' * 2000); f.close()", sandbox.Broken),
        ("import os; os.abort()", sandbox.Broken),
        ("import os; os.write(2, b'std::bad_alloc'); os.abort()", sandbox.TooMuchMemory),
        ("import os; os.kill(os.getpid(), 9)", sandbox.Killed),
    ],
)
def test_a_child_that_does_too_much_is_ended(
    code: str, error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each limit by its name, and nothing printed is taken for an answer."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error):
        sandbox.run("child", [f"print(1)\n{code}"], Limits(1 << 28, 1, file_bytes=1000))


def test_a_child_that_talks_much_is_not_held_up(caplog: pytest.LogCaptureFixture) -> None:
    """The end of what it said is logged where it breaks."""
    code = "sys.stderr.write('x' * 300_000 + 'the reason'); sys.exit(3)"
    with pytest.raises(sandbox.Broken, match="exit status 3"):
        sandbox.run("child", [code], Limits(1 << 28, 10))
    assert "the reason" in caplog.text and len(caplog.text) < 20_000


def test_a_child_ends_with_its_parent() -> None:
    """Even if the parent is killed while the child computes."""
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        time.sleep(0.1)
        parent.kill()
    child.wait(20)
