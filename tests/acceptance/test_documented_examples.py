"""Every example of the documentation: commands parse and name what is there, Python runs.

A block of code has a language. One whose first line is `# not tested: why` is not run; its commands
are read all the same. A block without a language is a formula or what a program prints.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
import trimesh
from markdown_it import MarkdownIt
from typer.main import get_group

from chamfer_morph.cli.app import app
from examples.service_demo import serving

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md")])
NOT_TESTED = "# not tested: "
CODE = {"bash", "python", "json"}
CONFIGURATION = {"ini", "nginx", "yaml"}
RUN_AS_A_WHOLE = {"tutorial.md", "paraview.md", "blender.md"}
"""Pages whose commands are cheap enough to be run."""

OTHERS = {"source", "pip", "export", "docker", "openssl", "blender", ".ci/run"}
"""Programs whose arguments are not read."""

COMMANDS = re.compile(r"^(morph|make|python|pip|curl|from|import) ", re.M)
ADDRESSES = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))["paths"]

COARSE = """\
def compute_little():
    import morph_engine
    from chamfer_morph.client.client import MorphClient
    from morph_engine.presets import configure

    few = {"sampling.points_per_cell_edge": 1}
    morph_engine.configure = lambda name, settings: configure(name, settings | few | {"frames": 5})
    MorphClient.submit.__kwdefaults__["overrides"] = few

compute_little()
"""
"""What is run before an example in Python: particles that are few, a cell's edge one."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    text: str

    def __str__(self):
        """Where it is."""
        return f"{self.page.name}:{self.line}"

    @property
    def is_tested(self):
        """Whether it has no reason not to be."""
        return not self.text.startswith(NOT_TESTED)

    def commands(self):
        """The words of each command."""
        joined = self.text.replace("\\\n", " ")
        for line in joined.splitlines():
            inner = re.search(r"\$\((.+?)\)", line)
            if words := shlex.split(inner[1] if inner else line, comments=True):
                yield words


BLOCKS = [
    Block(page, token.map[0] + 1, token.info.strip(), token.content)
    for page in PAGES
    for token in MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8"))
    if token.type == "fence"
]
PYTHON_PAGES = sorted({block.page for block in BLOCKS if block.language == "python"})
SHELL = [block for block in BLOCKS if block.language == "bash"]


def test_every_block_is_code_or_none():
    """A known language, or no commands; a reason not to be tested is one."""
    assert len(SHELL) > 20
    for block in BLOCKS:
        assert block.language in CODE | CONFIGURATION | {""}, block
        if not block.language:
            assert not COMMANDS.search(block.text), block
        if not block.is_tested:
            assert len(block.text.splitlines()[0]) > len(NOT_TESTED) + 5, block
        if block.language == "json":
            json.loads(block.text)


@pytest.mark.parametrize("block", SHELL, ids=str)
def test_commands_are_what_the_programs_take(block):
    """Options and arguments of `morph`, targets of make, modules, scripts, addresses."""
    for program, *arguments in block.commands():
        if program == "morph":
            parse(arguments)
        elif program == "make":
            assert re.search(rf"^{arguments[0]}:", (ROOT / "Makefile").read_text(), re.M)
        elif program == "python" and arguments[0] == "-m":
            assert find_spec(arguments[1]), arguments
        elif program == "python":
            script = ROOT / arguments[0]
            options = {word for word in arguments if word.startswith("--")}
            assert script.is_file() and all(option in script.read_text() for option in options)
        elif program == "curl":
            assert is_address(arguments), arguments
        else:
            assert program in OTHERS, program


def test_an_option_that_is_gone_is_noticed():
    """The parser is the command's own."""
    with pytest.raises(Exception, match="No such option"):
        parse(["run", "sphere", "star", "--no-such-option"])


@pytest.mark.site
@pytest.mark.parametrize("page", PYTHON_PAGES, ids=lambda page: page.name)
def test_python_runs(page, given, monkeypatch):
    """The blocks of a page one after another, with few particles."""
    blocks = [b for b in BLOCKS if b.page == page and b.language == "python" and b.is_tested]
    script = "\n".join([COARSE, *(block.text for block in blocks)])
    monkeypatch.setenv("MPLBACKEND", "Agg")
    if "MorphClient()" in script:
        with serving(given / "service") as server:
            monkeypatch.setenv("MORPH_SERVER", server)
            run([sys.executable, "-c", script], given)
    else:
        run([sys.executable, "-c", script], given)


@pytest.mark.site
@pytest.mark.parametrize("name", sorted(RUN_AS_A_WHOLE))
def test_commands_run(name, given):
    """The commands of a page one after another, as a reader types them."""
    (given / "bunny.glb").unlink()
    for block in SHELL:
        if block.page.name == name and block.is_tested:
            run(["bash", "-e", "-c", block.text], given)


@pytest.fixture(scope="module")
def made_once(tmp_path_factory):
    """What examples take for granted: two meshes, a result, files exported from it."""
    folder = tmp_path_factory.mktemp("given")
    trimesh.creation.icosphere(subdivisions=2, radius=6.0).export(folder / "bunny.obj")
    trimesh.creation.box((9.0, 9.0, 9.0)).export(folder / "duck.obj")
    trimesh.creation.icosphere(subdivisions=2, radius=6.0).export(folder / "bunny.glb")
    (folder / "examples").symlink_to(ROOT / "examples")
    result = "sphere-to-bunny.vtkhdf"
    small = ("--points-per-cell-edge", "1", "--frames", "3", "--out", result)
    run(["morph", "run", "sphere", "bunny.obj", *small], folder)
    run(["morph", "export", result, "-o", "bunny.npz"], folder)
    return folder


@pytest.fixture
def given(made_once, tmp_path):
    """A copy of it, in which an example may write."""
    return Path(shutil.copytree(made_once, tmp_path / "given", symlinks=True))


def parse(arguments):
    """Have the command's own parser read arguments.

    Raises:
        Exception: It refuses them.
    """
    if "--help" in arguments:
        arguments.remove("--help")
    command, context, name, rest = get_group(app), None, "morph", arguments
    while True:
        context = command.make_context(name, list(rest), parent=context)
        rest = [*getattr(context, "_protected_args", ()), *context.args]
        if not hasattr(command, "resolve_command") or not rest:
            return
        name, command, rest = command.resolve_command(context, rest)


def is_address(arguments):
    """Whether the API has an address, for the method that curl uses."""
    (address,) = (word for word in arguments if word.startswith("http"))
    path = re.sub(r"^http://[^/]+", "", address)
    method = "post" if {"-d", "-F"} & set(arguments) else "get"
    return any(
        re.fullmatch(re.sub(r"\\{.+?\\}", "[^/]+", re.escape(known)), path) and method in item
        for known, item in ADDRESSES.items()
    )


def run(command, folder):
    """Run a command in a folder, with the programs of this environment."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    outcome = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | {"PATH": path},
        timeout=600,
        capture_output=True,
        text=True,
    )
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
