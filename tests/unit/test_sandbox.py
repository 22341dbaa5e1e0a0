"""Children with little memory and time: the limits hold, and no child outlives its parent."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from chamfer_morph.worker.engines.engine import files_of_engine
from chamfer_morph.worker.sandbox import landlock, runner
from chamfer_morph.worker.sandbox.runner import Answer, Computation, CrashedError, Limits, Wording
from chamfer_morph.worker.storage import Storage
from morph_engine.child_process import python_command
from morph_engine.errors import MeshError, ResourceError
from tests.patience import PATIENCE

TASK = """
import sys
from collections.abc import Callable
from chamfer_morph.worker.sandbox.runner import Answer
from chamfer_morph.worker.storage import Storage
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
    progress = property(fset=lambda self, share: share and print(self.child.pid, flush=True))
    def begin(self, process):
        self.child = process
runner.run("task", {"code": "report_progress(0.5)\\nwhile True: pass"}, runner.Limits(1 << 28, 60),
           runner.Wording("It", "end", ""), Told())
"""
WORDING = Wording("The work", "end", "Do less.")


@pytest.fixture(autouse=True)
def task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that runs what it is told within its limits."""
    folder = tmp_path / "python"
    folder.mkdir()
    (folder / "task.py").write_text(TASK)
    monkeypatch.setenv("PYTHONPATH", str(folder))


class Recorded(Computation):
    """Keeps each share that it is told of."""

    def __init__(self) -> None:
        self.shares: list[float] = []
        super().__init__()

    progress = property(fset=lambda self, share: self.shares.append(share))


def run(code: str, limits: Limits, computation: Computation | None = None) -> Answer:
    """Run some code as a task."""
    return runner.run("task", {"code": code}, limits, WORDING, computation or Computation())


def without_network() -> bool:
    """Whether this system gives processes a network of their own."""
    return not subprocess.run(python_command("chamfer_morph.worker.sandbox.network")).returncode


def test_a_child_has_no_network(tmp_path: Path) -> None:
    """It reaches nobody, not even on this machine, and reads and writes files as ever."""
    if not without_network():
        pytest.skip("This system gives processes no network of their own.")
    code = f"""
import socket
try:
    socket.create_connection(("127.0.0.1", {{port}}), 5)
except OSError as error:
    answer = isinstance(error, OSError)
open({str(tmp_path / "written")!r}, "w").write("this")
"""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port), 5):
            limits = Limits(1 << 28, 10, 1 << 10, writes=(tmp_path,))
            answer = run(code.format(port=port), limits)
    assert answer == Answer(True)
    assert (tmp_path / "written").read_text() == "this"


PROBE = """
import os, socket, sys
from pathlib import Path
from chamfer_morph.worker.sandbox.offline import leave
leave(Path(sys.argv[1]))
try:
    socket.create_connection(("127.0.0.1", int(sys.argv[2])), 5)
    print("reached", end=" ")
except OSError:
    print("refused", end=" ")
print("here" if os.readlink("/proc/self/ns/net") == sys.argv[3] else "elsewhere")
"""


@pytest.mark.parametrize(
    ("devices", "found"),
    [
        ([], "refused elsewhere"),
        (["nvidia0", "nvidia-uvm"], "refused here"),
        (["nvidia0"], "reached here"),
    ],
)
def test_an_engine_leaves_what_its_gpu_does_not_need(
    devices: list[str], found: str, tmp_path: Path
) -> None:
    """The network where there is none, TCP where it is ready, and nothing where it is not."""
    if not without_network() or landlock.version() < 4:
        pytest.skip("This system does not let a process leave the network, or TCP.")
    (tmp_path / "dev").mkdir()
    for device in devices:
        (tmp_path / "dev" / device).touch()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port, network = server.getsockname()[1], os.readlink("/proc/self/ns/net")
        command = [sys.executable, "-c", PROBE, str(tmp_path), str(port), network]
        outcome = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    assert outcome.stdout.strip() == found


def test_a_module_is_run_offline(tmp_path: Path) -> None:
    """As a program, with its arguments, and with the exit status that it chooses."""
    (tmp_path / "python/program.py").write_text(
        "import sys\nif __name__ == '__main__':\n    print(sys.argv[1:])\n    sys.exit(3)\n"
    )
    files = files_of_engine(Storage(tmp_path / "data"))
    command = python_command("chamfer_morph.worker.sandbox.offline", files, "program", "a", "-b")
    outcome = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    assert (outcome.stdout.strip(), outcome.returncode) == ("['a', '-b']", 3)


@pytest.mark.skipif(not landlock.version(), reason="This system has no Landlock.")
@pytest.mark.skipif(any(Path("/dev").glob("nvidia*")), reason="CUDA needs files of the system.")
def test_an_engine_has_the_files_of_jobs_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the database nor what its worker knows; of other jobs, only until it has its own."""
    storage = Storage(tmp_path / "data")
    for variable, folder in (("TMPDIR", "temporary"), ("XDG_CACHE_HOME", "cache")):
        (tmp_path / folder).mkdir()
        monkeypatch.setenv(variable, str(tmp_path / folder))
    own, other = storage.job_dir("own") / "log.txt", storage.job_dir("other") / "log.txt"
    database, mesh = storage.root / "morph.sqlite", storage.root / "meshes/mesh.stl"
    for path in (own, other, database, mesh):
        path.parent.mkdir(exist_ok=True)
        path.write_text("this")
    (tmp_path / "python/program.py").write_text(ENGINE_PROBE)
    folders = tmp_path / "temporary", tmp_path / "cache/taichi", storage.kept_results
    written = [folder / "new" for folder in folders]
    asked = [*map(str, (own, mesh, other, database, f"/proc/{os.getpid()}/environ", *written))]

    def answers(job_dir: Path | None) -> str:
        files = files_of_engine(storage, job_dir)
        offline = python_command("chamfer_morph.worker.sandbox.offline", files, "program", *asked)
        return subprocess.run(offline, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()

    assert answers(None) == str([*3 * [True], *2 * [False], *3 * [True]])
    assert answers(own.parent) == str([*2 * [True], *3 * [False], *3 * [True]])


ENGINE_PROBE = """
import sys
def may(path, how):
    try:
        open(path, how).close()
    except PermissionError:
        return False
    return True
print([may(path, "w" if path.endswith("new") else "r") for path in sys.argv[1:]])
"""


AS_NOBODY = """
import ctypes, os, sys
from chamfer_morph.worker.private_process import keep_private
if os.geteuid() == 0:  # whom the system keeps nothing from
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
    ctypes.CDLL(None).prctl(4, 1, 0, 0, 0)  # as any process begins that has not been root
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux knows such processes")
@pytest.mark.parametrize(("call", "read"), [("", True), ("keep_private()", False)])
def test_what_a_process_knows_is_private(call: str, read: bool) -> None:
    """Another process of the same user, as an engine is, reads none of its environment."""
    keep = f"{AS_NOBODY}{call}\nprint('ready', flush=True)\ninput()"
    look = f"{AS_NOBODY}print(len(open(sys.argv[1]).read()))"
    with subprocess.Popen(
        [sys.executable, "-c", keep], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as keeper:
        assert keeper.stdin and keeper.stdout
        assert keeper.stdout.readline() == b"ready\n"
        environment = f"/proc/{keeper.pid}/environ"
        outcome = subprocess.run(
            [sys.executable, "-c", look, environment], capture_output=True, text=True
        )
        keeper.stdin.close()
    assert (outcome.returncode == 0) is read
    assert ("Permission denied" in outcome.stderr) is not read


@pytest.mark.skipif(not landlock.version(), reason="This system has no Landlock.")
def test_a_child_has_the_files_of_its_task_alone(tmp_path: Path) -> None:
    """Neither the database nor other meshes, nor what its parent knows; it changes what it may."""
    (tmp_path / "job").mkdir()
    for name in ("morph.sqlite", "other.stl", "mesh.stl", "job/result"):
        (tmp_path / name).write_text("this")
    outside = [tmp_path / "morph.sqlite", tmp_path / "other.stl", f"/proc/{os.getpid()}/environ"]
    code = f"""
import os
global does
def does(action, *arguments):
    try:
        action(*arguments)
    except PermissionError:
        return False
    return True
answer = (
    [does(lambda path=path: open(path).read()) for path in {[*map(str, outside)]}],
    [does(os.listdir, {str(tmp_path)!r}), does(os.kill, {os.getpid()}, 0)],
    [does(lambda: open({str(tmp_path / "mesh.stl")!r}).read()),
     does(lambda: open({str(tmp_path / "mesh.stl")!r}, "a")),
     does(lambda: open({str(tmp_path / "other.stl")!r}, "a")),
     does(os.unlink, {str(tmp_path / "other.stl")!r})],
    [does(lambda: open({str(tmp_path / "job/new")!r}, "w").write("that")),
     does(os.replace, {str(tmp_path / "job/new")!r}, {str(tmp_path / "job/result")!r})],
)
"""
    mesh, job = tmp_path / "mesh.stl", tmp_path / "job"
    answer = run(code, Limits(1 << 28, 10, 1 << 10, reads=(mesh,), writes=(job,))).value
    signals = landlock.version() < 6
    assert answer == [3 * [False], [False, signals], [True, False, False, False], [True, True]]
    assert (job / "result").read_text() == "that" and (tmp_path / "other.stl").exists()


@pytest.mark.skipif(not landlock.version(), reason="This system has no Landlock.")
@pytest.mark.parametrize("is_kept", [True, False])
def test_a_child_knows_which_fonts_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_kept: bool
) -> None:
    """By the list that Matplotlib keeps, which it cannot change, or else by one of its own."""
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "matplotlib").mkdir()
    if is_kept:
        (tmp_path / "matplotlib/fontlist.json").write_text("kept")
    code = """
from pathlib import Path
import os
fonts = Path(os.environ["MPLCONFIGDIR"], "fontlist.json")
try:
    fonts.write_text("its own")
except PermissionError:
    pass
answer = fonts.read_text()
"""
    answer = run(code, Limits(1 << 28, 10, file_bytes=100)).value
    assert answer == ("kept" if is_kept else "its own")
    assert [path.read_text() for path in tmp_path.glob("matplotlib/*")] == ["kept"] * is_kept


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
        ("raise OSError(11, 'Resource temporarily unavailable')", ResourceError, "256 MiB"),
        ("import os; os.kill(os.getpid(), 9)", ResourceError, "killed from outside"),
        ("import os; os._exit(0)", CrashedError, "status 0"),
    ],
)
def test_a_child_that_does_too_much_is_ended(
    code: str, error: type[Exception], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each limit by its name, and nothing printed is taken for an answer."""
    monkeypatch.chdir(tmp_path)
    seconds = 1 if code.startswith("while") else 60  # a busy machine takes long to start it
    with pytest.raises(error, match=words):
        run(f"print(1)\n{code}", Limits(1 << 28, seconds, file_bytes=1000, writes=(tmp_path,)))


def test_a_child_that_talks_much_is_not_held_up(caplog: pytest.LogCaptureFixture) -> None:
    """The end of what it said is logged where it breaks."""
    code = "sys.stderr.write('x' * 300_000 + 'the reason'); sys.exit(3)"
    with pytest.raises(CrashedError, match="exit status 3"):
        run(code, Limits(1 << 28, 10))
    assert "the reason" in caplog.text and len(caplog.text) < 20_000


def test_a_child_knows_no_passwords(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the environment it has what libraries need, and no variable that is not known."""
    secrets = (
        "MORPH_DATABASE_URL", "AWS_SECRET_ACCESS_KEY", "PGPASSWORD", "HTTPS_PROXY", "GITHUB_TOKEN",
        "GOOGLE_APPLICATION_CREDENTIALS",
    )  # fmt: skip
    for name in secrets:
        monkeypatch.setenv(name, "https://morph:secret@host")
    needed = {"LC_NUMERIC": "C", "XDG_CACHE_HOME": "/cache", "CUDA_VISIBLE_DEVICES": "1"}
    for name, value in needed.items():
        monkeypatch.setenv(name, value)
    answer = run("import os; answer = dict(os.environ)", Limits(1 << 30, 60)).value
    assert [name for name, value in answer.items() if "secret" in value] == []
    assert answer.items() >= (needed | {"PATH": os.environ["PATH"]}).items()


def test_a_child_ends_with_its_parent() -> None:
    """Even if the parent is killed while the child computes."""
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        parent.kill()
    child.wait(PATIENCE)
