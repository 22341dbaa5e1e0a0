"""What is built and installed: two names, and nothing imported from where the user stands."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
import trimesh

from tests.conftest import MESHES, extraction_filter
from tests.core_environment import MOST_DISTRIBUTIONS, make_core_environment, site_packages_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="paths and processes as of POSIX")

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"chamfer_morph", "morph_engine"}
SMALL = ("--points-per-cell-edge", "1", "--frames", "2")

FOREIGN_MODULES = ("server/__init__.py", "client.py", "worker.py", "cli/__init__.py")
"""Another package's, in the same environment."""

USER_MODULES = (
    "server.py", "worker/__init__.py", "reproduction/__init__.py", "client.py", "cli.py",
    "schemas.py", "chamfer_morph.py", "morph_engine/__init__.py", "queue.py", "json.py", "numpy.py",
)  # fmt: skip
"""The user's own, in the working directory; some have names of the standard library."""


OLDEST = "3.10 with the oldest packages allowed"
NEWEST = "3.13 with the newest packages allowed"

OF_THE_CHECKOUT = ("tests/unit/test_architecture_map.py",)
"""Tests of what a checkout looks like, and no wheel."""


def build(target: str, source: Path, folder: Path) -> Path:
    """Build a wheel or an sdist; without Node.js where the page is there, to be packed as it is."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(folder)]
    page_is_there = (source / "server" / "web" / "dist" / "index.html").is_file()
    environment = os.environ | ({"PATH": ""} if page_is_there else {})
    subprocess.run(command, cwd=source, env=environment, check=True, capture_output=True)
    (archive,) = folder.iterdir()
    return archive


def names_in(wheel: Path) -> list[str]:
    """Names of all files in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return sorted(archive.namelist())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout."""
    return build("wheel", ROOT, tmp_path_factory.mktemp("wheel"))


def test_a_wheel_installs_two_typed_packages_and_no_tests(wheel):
    """Everything lies in one of them; both tell type checkers that they have types."""
    names = names_in(wheel)
    assert {name.partition("/")[0].partition("-")[0] for name in names} == PACKAGES
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    sources = {
        package.removeprefix("chamfer_morph/") + name.removeprefix(package)
        for name in names
        for package in re.findall(r"^(morph_engine|chamfer_morph/\w+)(?=/)", name)
        if name.endswith(".py")
    }
    rooms = {source.partition("/")[0] for source in sources}
    assert rooms == {"morph_engine", *_linked_folders()}
    committed = {
        str(path.relative_to(ROOT)) for room in rooms for path in ROOT.glob(f"{room}/**/*.py")
    }
    assert sources == {path for path in committed if "node_modules" not in path}
    check = [Path(sys.executable).with_name("check-wheel-contents"), wheel]
    subprocess.run(check, cwd=ROOT, check=True)


def test_a_wheel_holds_the_page_where_it_was_built(wheel):
    """With its compressed copies, and nothing that it was made of; and so the viewer of exports.

    Both with the licences of the libraries in them.
    """
    page = ROOT / "server" / "web" / "dist"
    built = {str(path.relative_to(page)) for path in page.rglob("*") if path.is_file()}
    prefix = "chamfer_morph/server/web/"
    names = names_in(wheel)
    packed = {name.removeprefix(prefix) for name in names if name.startswith(prefix)}
    assert packed == {f"dist/{name}" for name in built}
    assert "dist/licenses.txt" in packed
    viewer = {name for name in names if name.startswith("morph_engine/export/viewer/")}
    assert {Path(name).name for name in viewer} == {"licenses.txt", "viewer.css", "viewer.js"}


@pytest.mark.distribution
def test_a_checkout_without_node_builds_the_page(tmp_path):
    """Node.js comes as a package then; nothing else of the machine is needed but a shell."""
    _copy_committed_files(tmp_path / "source")
    programs = tmp_path / "bin"
    programs.mkdir()
    (programs / "sh").symlink_to(shutil.which("sh"))
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps",
         "--wheel-dir", tmp_path / "wheel", tmp_path / "source"],
        env=os.environ | {"PATH": str(programs)}, check=True,
    )  # fmt: skip
    (wheel,) = (tmp_path / "wheel").iterdir()
    names = names_in(wheel)
    assert "chamfer_morph/server/web/dist/index.html" in names
    assert "morph_engine/export/viewer/viewer.js" in names


def test_an_sdist_holds_what_make_needs_and_gives_the_same_wheel(wheel, tmp_path):
    """Every committed file but the links, which an editable install makes."""
    sdist = build("sdist", ROOT, tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", **extraction_filter())
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    for name in ("Makefile", "requirements.lock", "tests/conftest.py", "docs/api.md", ".ci/run"):
        assert (unpacked / name).is_file()
    assert names_in(build("wheel", unpacked, tmp_path / "wheel")) == names_in(wheel)

    editable = "import sys; from hatchling.build import build_editable; build_editable(sys.argv[1])"
    subprocess.run(
        [sys.executable, "-c", editable, tmp_path], cwd=unpacked, env=os.environ | {"PATH": ""},
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    for name in _linked_folders():
        assert (unpacked / "chamfer_morph" / name).resolve() == (unpacked / name).resolve()


def test_a_checkout_without_links_works(tmp_path):
    """As git makes one on Windows: the package finds its parts beside itself."""
    (tmp_path / "chamfer_morph").mkdir()
    shutil.copy(ROOT / "chamfer_morph" / "__init__.py", tmp_path / "chamfer_morph")
    (tmp_path / "chamfer_morph" / "server").write_text("../server")
    (tmp_path / "server").mkdir()
    (tmp_path / "server" / "__init__.py").write_text("print('found')")
    code = "import sys; sys.path.insert(0, sys.argv[1]); import chamfer_morph.server"
    found = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True)
    assert found.stdout == "found\n", found.stderr


class Installation:
    """The wheel in an environment with foreign modules, used from a folder with the user's own.

    All of these write to `imported` when somebody imports them, and fail.
    """

    def __init__(self, python: Path, folder: Path):
        """Lay out the modules that nobody may import."""
        self.python = python
        self.imported = folder / "imported"
        self.cwd = folder / "user"
        paths = subprocess.check_output(
            [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True
        )
        self._write_traps(Path(paths.strip()), FOREIGN_MODULES)
        self._write_traps(self.cwd, USER_MODULES)
        kept = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
        self.environment = {k: v for k, v in kept.items() if not k.startswith("PYTHON")}

    def _write_traps(self, folder: Path, names: tuple[str, ...]) -> None:
        for name in names:
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(
                f"open({str(self.imported)!r}, 'a').write({str(path)!r} + '\\n')\n"
                f"raise ImportError({str(path)!r})\n"
            )

    def command(self, *arguments: object) -> list[str]:
        """The command line of a `morph` command."""
        return [str(self.python.with_name("morph")), *map(str, arguments)]

    def morph(self, *arguments: object) -> str:
        """Run a command to its end; what it prints."""
        outcome = subprocess.run(
            self.command(*arguments),
            cwd=self.cwd, env=self.environment, timeout=600, capture_output=True, text=True,
        )  # fmt: skip
        assert outcome.returncode == 0, (arguments, outcome.stderr)
        self.require_no_foreign_imports()
        return outcome.stdout

    def start(self, *arguments: object) -> subprocess.Popen[bytes]:
        """Start a command that runs until it is told to end."""
        return subprocess.Popen(self.command(*arguments), cwd=self.cwd, env=self.environment)

    def require_no_foreign_imports(self) -> None:
        """Nothing was imported that is not ours, in any process."""
        assert not self.imported.exists(), self.imported.read_text()


def _every_python() -> Iterator[object]:
    yield pytest.param("", id="this")
    for minor in range(10, 14):
        yield pytest.param(f"3.{minor}", marks=pytest.mark.distribution)
    yield pytest.param(OLDEST, marks=pytest.mark.distribution)


@pytest.fixture(scope="module", params=_every_python())
def installation(
    request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory
) -> Installation:
    """The wheel with all extras, installed for a version of Python.

    For the running one it finds the packages that are here.
    """
    folder = tmp_path_factory.mktemp("installation")
    if request.param:
        return Installation(_install(f"{wheel}[all]", request.param, folder), folder)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    _add_wheel(wheel, python)
    # packages alone: the .pth file of an editable install there is not read
    shared = [path for path in sys.path if Path(path).name == "site-packages"]
    (site_packages_of(python) / "shared.pth").write_text("\n".join(shared))
    return Installation(python, folder)


@pytest.fixture(scope="module", params=_every_python())
def core(
    request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory
) -> Installation:
    """The wheel without extras; for the running Python the packages that it requires are links."""
    folder = tmp_path_factory.mktemp("core")
    if request.param:
        return Installation(_install(str(wheel), request.param, folder), folder)
    python = make_core_environment(folder / "venv", with_project=False)
    _add_wheel(wheel, python)
    return Installation(python, folder)


def test_the_core_is_small_and_computes(core):
    """Few packages come along, and a morph needs no others."""
    others = [path for path in site_packages_of(core.python).glob("*.dist-info")]
    names = {path.name.partition("-")[0] for path in others} - {
        "chamfer_morph",
        "pip",
        "setuptools",
    }
    assert 20 < len(names) <= MOST_DISTRIBUTIONS, sorted(names)
    assert " submit " in core.morph("--help")
    core.morph("run", "sphere", "torus", *SMALL, "--out", "a.vtkhdf", "--quiet")
    core.morph("metrics", "a.vtkhdf")
    core.morph("render", "a.vtkhdf", "--size", "64x48", "-o", "a.gif", "--quiet")


@pytest.mark.parametrize(
    ("command", "extra"),
    [("submit sphere star", "client"), ("serve", "service"), ("run text:A star", "text"),
     ("reproduce trial", "reproduce")],
)  # fmt: skip
def test_the_core_names_the_extra_that_a_command_lacks(core, command, extra):
    """As the last thing it says, with the exit status of input that can be mended."""
    outcome = subprocess.run(
        core.command(*command.split()),
        cwd=core.cwd, env=core.environment, capture_output=True, text=True,
    )  # fmt: skip
    assert outcome.returncode == 2, outcome.stderr
    assert outcome.stderr.endswith(f"Install it with: pip install 'chamfer-morph[{extra}]'\n")


def test_commands_on_files(installation):
    """Runs and what is done with their results."""
    morph = installation.morph
    trimesh.creation.box((30, 20, 10)).export(installation.cwd / "box.obj")
    morph("--help")
    for listing in ("methods", "presets", "shapes", "reproduce"):
        morph(listing)
    morph("inspect", "box.obj")
    morph("run", "box.obj", "star", *SMALL, "--out", "a.vtkhdf", "--quiet")
    morph("rerun", "a.vtkhdf", "--out", "b.vtkhdf", "--quiet")
    morph("metrics", "a.vtkhdf", "b.vtkhdf")
    morph("export", "a.vtkhdf", "--surface", "--frames", "-1", "-o", "a.glb", "--quiet")
    morph("render", "a.vtkhdf", "--size", "64x48", "-o", "a.gif", "--quiet")


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_public_types_are_complete(installation, package, tmp_path):
    """At least 99 % of the public names have types that every type checker reads alike."""
    outcome = subprocess.run(
        [sys.executable, "-m", "pyright", "--verifytypes", package, "--ignoreexternal",
         "--outputjson"],
        cwd=tmp_path, env=_pyright_environment(installation),
        capture_output=True, text=True,
    )  # fmt: skip
    report = json.loads(outcome.stdout)["typeCompleteness"]
    assert report["exportedSymbolCounts"]["withKnownType"] > 500
    assert report["completenessScore"] >= 0.99


@pytest.mark.distribution
def test_the_reproduction(installation):
    """Its runs are processes of their own."""
    installation.morph("reproduce", "trial", "--quick", "--results", "results", "--quiet")
    assert (installation.cwd / "results" / "report.html").is_file()


@pytest.mark.distribution
def test_the_service(installation, tmp_path):
    """API, janitor, worker, engine processes, and the processes that read meshes and export."""
    morph = installation.morph
    trimesh.creation.box((30, 20, 10)).export(installation.cwd / "box.obj")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = f"http://127.0.0.1:{port}"
    options = ("--server", server)
    process = installation.start("serve", "--port", port, "--workers", 1, "--data-dir", tmp_path)
    try:
        _wait_for(lambda: _answers(f"{server}/readyz"))
        job = morph("submit", "box.obj", "star", *SMALL, *options, "--quiet").strip()
        morph("watch", job, *options)
        morph("fetch", job, "--out", "fetched.vtkhdf", *options)
        morph("export", job, "--surface", "--frames", "-1", "-o", "job.ply", *options, "--quiet")
        for listing in (("jobs",), ("show", job), ("workers", "list"), ("keys", "list")):
            morph(*listing, *options)
        morph("delete", job, *options)
    finally:
        process.terminate()
        assert process.wait(30) == 0
    installation.require_no_foreign_imports()


@pytest.mark.distribution
def test_a_worker(installation, tmp_path):
    """`morph worker` starts slots, each of which has a lock as soon as it is ready for jobs."""
    process = installation.start("worker", "--slots", 1, "--data-dir", tmp_path)
    try:
        _wait_for(lambda: any((tmp_path / "locks").glob("*")))
    finally:
        process.terminate()
        assert process.wait(30) == 0
    installation.require_no_foreign_imports()


@pytest.mark.distribution
@pytest.mark.parametrize("version", [OLDEST, NEWEST])
def test_the_suite_passes(wheel, version, tmp_path):
    """All that `make test` runs, in a checkout without the packages, which the wheel brings."""
    python = _install(f"{wheel}[dev]", version, tmp_path)
    checkout = tmp_path / "checkout"
    _copy_committed_files(checkout)
    for package in PACKAGES:
        shutil.rmtree(checkout / package)
    left_out = [f"--deselect={name}" for name in OF_THE_CHECKOUT]
    subprocess.run(
        [python, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "--no-loadscope-reorder",
         *left_out, "tests/integration", "tests/unit"],
        cwd=checkout, env=os.environ | {"MORPH_MESHES": str(MESHES)}, check=True,
    )  # fmt: skip


def _copy_committed_files(folder: Path) -> None:
    """Make a checkout of this one, with the changes that are not committed yet."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    for name in listed.rstrip("\0").split("\0"):
        copy = folder / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, copy, follow_symlinks=False)


def _linked_folders() -> set[str]:
    return {path.name for path in (ROOT / "chamfer_morph").iterdir() if path.is_symlink()}


def _pyright_environment(installation: Installation) -> dict[str, str]:
    """What makes pyright look at an installation, find Node.js, and say nothing but its report."""
    folders = (installation.python.parent, Path(sys.executable).parent, os.environ["PATH"])
    path = os.pathsep.join(map(str, folders))
    return installation.environment | {"PATH": path, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}


def _install(requirement: str, version: str, folder: Path) -> Path:
    """Install for a version of Python, in an environment of its own; returns its Python."""
    interpreter = _find_python(version.partition(" ")[0])
    constraints = folder / "constraints.txt"
    if version == OLDEST:
        constraints.write_text(_oldest_allowed(interpreter))
    elif version == NEWEST:
        constraints.write_text("")
    else:
        constraints.write_text(
            re.sub(r" \\\n +--hash.*", "", (ROOT / "requirements.lock").read_text())
        )
    subprocess.run([interpreter, "-m", "venv", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet", "-c", constraints, requirement]
    subprocess.run(install, check=True)
    return python


def _add_wheel(wheel: Path, python: Path) -> None:
    """Install a wheel, and nothing that it requires, in an environment without pip."""
    subprocess.run(
        [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps",
         "--no-index", wheel],
        check=True,
    )  # fmt: skip


def _oldest_allowed(interpreter: Path) -> str:
    """The oldest version that pyproject.toml allows of each package."""
    return subprocess.run(
        [Path(sys.executable).with_name("uv"), "pip", "compile", "--quiet", "--resolution",
         "lowest-direct", "--extra", "dev", "--python", interpreter, "pyproject.toml"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip


def _find_python(version: str) -> Path:
    """An interpreter of a version, on the path or among those of pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    found = [*sorted(pyenv.glob(f"{version}.*/bin/python")), shutil.which(f"python{version}")]
    for python in filter(None, found):
        if subprocess.run([python, "--version"], check=False, capture_output=True).returncode == 0:
            return Path(python)
    pytest.skip(f"there is no Python {version} here")


def _answers(url: str) -> bool:
    try:
        return httpx.get(url).is_success
    except httpx.TransportError:
        return False


def _wait_for(condition: Callable[[], bool], seconds: float = 600) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)
