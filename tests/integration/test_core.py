"""The core, `pip install chamfer-morph` without extras: what it does, and what it says it lacks."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from chamfer_morph.cli.app import COMMANDS
from tests.core_environment import (
    MOST_DISTRIBUTIONS,
    core_distributions,
    make_core_environment,
)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links and paths as of POSIX")

SMALL = ("--method", "dco", "--points-per-cell-edge", "1", "--frames", "1", "--quiet")

OF_EXTRAS = {
    "chamfer_morph.cli.mesh_fetch",
    "chamfer_morph.cli.remote_runs",
    "chamfer_morph.cli.reproduce_display",
    "chamfer_morph.cli.watching",
    "chamfer_morph.cli.web_download",
    "morph_engine.geometry.text",
}
"""Modules of command and engine that need an extra; what uses them imports them where it does."""

IMPORT_ALL = """
import importlib, json, pkgutil, sys
import chamfer_morph.cli, chamfer_morph.schemas, morph_engine

failed = {}
for package in (chamfer_morph.cli, chamfer_morph.schemas, morph_engine):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        try:
            importlib.import_module(module.name)
        except ImportError as error:
            failed[module.name] = str(error)
print(json.dumps(failed))
"""


class Core:
    """The project without its extras, used from a folder of its own."""

    def __init__(self, folder: Path) -> None:
        """Make the environment."""
        self.folder = folder / "user"
        self.folder.mkdir()
        self._python = make_core_environment(folder / "venv", with_project=True)

    def python(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        """Run Python to its end."""
        kept = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
        return subprocess.run(
            [self._python, *map(str, arguments)],
            cwd=self.folder, env=kept, capture_output=True, text=True,
        )  # fmt: skip

    def morph(self, *arguments: object) -> str:
        """What a command prints, which has to succeed."""
        outcome = self.python("-m", "chamfer_morph", *arguments)
        assert outcome.returncode == 0, (arguments, outcome.stderr)
        return outcome.stdout


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Core:
    """An environment with a result in its folder."""
    made = Core(tmp_path_factory.mktemp("core"))
    made.morph("run", "sphere", "torus", *SMALL, "--out", "a.vtkhdf")
    return made


def test_it_has_few_requirements() -> None:
    """Those of requirements included."""
    assert len(core_distributions()) <= MOST_DISTRIBUTIONS


def test_modules_import_what_the_core_has(core: Core) -> None:
    """All of the engine and of the command, but for the few that are there for an extra."""
    outcome = core.python("-c", IMPORT_ALL)
    assert outcome.returncode == 0, outcome.stderr
    failed = json.loads(outcome.stdout)
    assert set(failed) == OF_EXTRAS, failed


def test_the_help_lists_all_commands(core: Core) -> None:
    """Those of the service, too."""
    listed = core.morph("--help")
    assert all(f" {command} " in listed for command in COMMANDS)
    for command in ("run", "submit", "serve"):
        assert f"morph {command} " in core.morph(command, "--help")


def test_commands_on_this_machine(core: Core) -> None:
    """A result is measured, repeated, exported, drawn and shown."""
    for command in ("methods", "presets", "shapes"):
        core.morph(command)
    core.morph("inspect", "heart")
    core.morph("rerun", "a.vtkhdf", "--out", "b.vtkhdf", "--quiet")
    core.morph("metrics", "a.vtkhdf", "b.vtkhdf")
    core.morph("metrics", "a.vtkhdf", "--path")
    core.morph("export", "a.vtkhdf", "--surface", "-o", "a.glb", "--quiet")
    core.morph("export", "a.vtkhdf", "--fields", "displacement", "-o", "a.ply", "--quiet")
    core.morph("view", "a.vtkhdf", "--no-browser", "-o", "b.html", "--quiet")
    core.morph("render", "a.vtkhdf", "--size", "64x48", "-o", "a.gif", "--quiet")


def test_doctor_tells_that_there_is_no_service(core: Core) -> None:
    """Which is no fault of a machine that computes its own runs."""
    findings = json.loads(core.morph("doctor", "--no-compute", "--json"))["findings"]
    assert {finding["verdict"] for finding in findings} <= {"ok", "warning"}
    assert findings[-1]["subject"] == "service"
    assert "pip install 'chamfer-morph[service]'" in findings[-1]["text"]


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        ("submit sphere star", "client"),
        ("jobs", "client"),
        ("watch 1", "client"),
        ("fetch 1", "client"),
        ("cancel 1", "client"),
        ("share 1", "client"),
        ("queue show", "client"),
        ("webhooks list", "client"),
        ("sweep --sources sphere --targets star", "client"),
        ("keys list", "client"),
        ("workers list", "client"),
        ("export 0123456789abcdefghijklmnop -o job.ply", "client"),
        ("serve", "service"),
        ("worker", "service"),
        ("backup copy", "service"),
        ("restore copy", "service"),
        ("reproduce", "reproduce"),
        ("shapes fetch", "reproduce"),
        ("run text:A sphere", "text"),
        ("render a.vtkhdf -o a.mp4", "video"),
        ("export a.vtkhdf -o a.usdc", "usd"),
    ],
)
def test_a_command_names_the_extra_that_it_lacks(core: Core, command: str, extra: str) -> None:
    """In a sentence with the cause and one with what to type, as for other bad input."""
    outcome = core.python("-m", "chamfer_morph", *command.split())
    assert outcome.returncode == 2, outcome.stderr
    cause, remedy = outcome.stderr.strip().splitlines()[-2:]
    assert "needs the Python package" in cause
    assert remedy == f"Install it with: pip install 'chamfer-morph[{extra}]'"


@pytest.mark.parametrize(
    ("package", "extra"),
    [("client", "client"), ("server", "service"), ("worker", "service"),
     ("reproduction", "reproduce")],
)  # fmt: skip
def test_a_package_names_the_extra_that_it_lacks(core: Core, package: str, extra: str) -> None:
    """Its import fails as that of any absent package does, and says what to type."""
    code = (
        f"try: import chamfer_morph.{package}\nexcept ImportError as error: print(error); exit()\n"
        "exit('it is imported')"
    )
    outcome = core.python("-c", code)
    assert outcome.returncode == 0, outcome.stderr
    assert "needs the Python package" in outcome.stdout
    assert f"pip install 'chamfer-morph[{extra}]'" in outcome.stdout
