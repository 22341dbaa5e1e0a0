"""Children with little memory and time: the limits hold, and no child outlives its parent."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from chamfer_morph.worker.sandbox import runner
from chamfer_morph.worker.sandbox.runner import Answer, Computation, CrashedError, Limits, Wording
from morph_engine.child_process import python_command
from morph_engine.errors import MeshError, ResourceError

TASK = """
import sys
from collections.abc import Callable
from chamfer_morph.worker.sandbox.runner import Answer
from morph_engine.child_process import python_command
from morph_engine.errors import MeshError
def run(code: str, report_progress: Callable[[float], None]):
    found = {"report_progress": report_progress}
    exec(code, globals(), found)
    return found.get("answer")
"""
PARENT = """
from chamfer_morph.worker.sandbox import runner
class Told(runner.Computation):
    def begin(self, process):
        print(process.pid, flush=True)
runner.run("task", {"code": "while True: pass"}, runner.Limits(1 << 28, 60),
           runner.Wording("It", "end", ""), Told())
"""
WORDING = Wording("The work", "end", "Do less.")


@pytest.fixture(autouse=True)
def task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that runs what it is told within its limits."""
    (tmp_path / "task.py").write_text(TASK)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


class Recorded(Computation):
    """Keeps each share that it is told of."""

    def __init__(self) -> None:
        self.shares: list[float] = []
        super().__init__()

    progress = property(fset=lambda self, share: self.shares.append(share))


def run(code: str, limits: Limits, computation: Computation | None = None) -> Answer:
    """Run some code as a task."""
    return runner.run("task", {"code": code}, limits, WORDING, computation or Computation())


def test_a_child_has_no_network(tmp_path: Path) -> None:
    """It reaches nobody, not even on this machine, and reads and writes files as ever."""
    if subprocess.run(python_command("chamfer_morph.worker.sandbox.network")).returncode:
        pytest.skip("This system gives processes no network of their own.")
    code = f"""
import socket
try:
    socket.create_connection(("127.0.0.1", {{port}}), 5)
except OSError as error:
    answer = type(error).__name__
open({str(tmp_path / "written")!r}, "w").write("this")
"""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port), 5):
            answer = run(code.format(port=port), Limits(1 << 28, 10, 1 << 10))
    assert answer == Answer("OSError")
    assert (tmp_path / "written").read_text() == "this"


def test_what_a_task_returns_is_its_answer() -> None:
    """Values and bytes; how far it has come is told meanwhile, and what it prints is no answer."""
    code = (
        "report_progress(0.25); print('printed'); sys.stdout.flush(); report_progress(1)\n"
        "answer = Answer({'one': [1, None]}, bytes(range(256)))"
    )
    computation = Recorded()
    answer = run(code, Limits(1 << 28, 10), computation)
    assert answer == Answer({"one": [1, None]}, bytes(range(256)))
    assert computation.shares == [0, 0.25, 1]
    assert run("answer = 'text'", Limits(1 << 28, 10)) == Answer("text")


def test_what_a_task_raises_is_raised() -> None:
    """An error with cause and remedy is of the same kind on the other side."""
    with pytest.raises(MeshError) as caught:
        run("raise MeshError('No inside.', 'Close it.')", Limits(1 << 28, 10))
    assert (caught.value.cause, caught.value.remedy) == ("No inside.", "Close it.")


@pytest.mark.parametrize(
    ("code", "error", "words"),
    [
        ("bytearray(1 << 30)", ResourceError, "more than 256 MiB of memory to end"),
        ("while True: pass", ResourceError, "more than 1 s to end"),
        ("f = open('large', 'wb'); f.write(b'0' * 2000); f.close()", CrashedError, "status 1"),
        ("import os; os.abort()", CrashedError, "SIGABRT"),
        ("import os; os.write(2, b'std::bad_alloc'); os.abort()", ResourceError, "256 MiB"),
        ("import os; os.kill(os.getpid(), 9)", ResourceError, "killed from outside"),
        ("import os; os._exit(0)", CrashedError, "status 0"),
    ],
)
def test_a_child_that_does_too_much_is_ended(
    code: str, error: type[Exception], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each limit by its name, and nothing printed is taken for an answer."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=words):
        run(f"print(1)\n{code}", Limits(1 << 28, 1, file_bytes=1000))


def test_a_child_that_talks_much_is_not_held_up(caplog: pytest.LogCaptureFixture) -> None:
    """The end of what it said is logged where it breaks."""
    code = "sys.stderr.write('x' * 300_000 + 'the reason'); sys.exit(3)"
    with pytest.raises(CrashedError, match="exit status 3"):
        run(code, Limits(1 << 28, 10))
    assert "the reason" in caplog.text and len(caplog.text) < 20_000


def test_a_child_knows_no_passwords(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the database's nor the object store's are in its environment."""
    monkeypatch.setenv("MORPH_DATABASE_URL", "postgresql://morph:secret@host/morph")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("PGPASSWORD", "secret")
    code = "import os; answer = Answer([n for n, v in os.environ.items() if 'secret' in v])"
    assert run(code, Limits(1 << 30, 60)).value == []


def test_a_child_ends_with_its_parent() -> None:
    """Even if the parent is killed while the child computes."""
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        time.sleep(0.1)
        parent.kill()
    child.wait(20)
