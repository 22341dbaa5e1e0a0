"""Child processes import nothing from the folder where the user happens to stand."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from morph_engine import child_process
from morph_engine.child_process import python_command

INTRUDERS = ("server", "worker", "reproduction", "client", "queue", "json", "runpy", "greeting")


@pytest.fixture
def hostile_folder(tmp_path: Path) -> Path:
    """A working directory with modules and packages of many names; each raises when imported."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in INTRUDERS:
        (folder / f"{name}.py").write_text(f"raise SystemExit('{name} was imported')\n")
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(f"raise SystemExit('{name} was imported')\n")
    return folder


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder for PYTHONPATH with a package to run, which imports and prints its arguments."""
    folder = tmp_path / "path" / "greeting"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "__main__.py").write_text(
        "import json, queue, runpy, sys\n"
        "from greeting.words import HELLO\n"
        "assert __name__ == '__main__' and sys.argv[0].endswith('__main__.py')\n"
        "print(HELLO, *sys.argv[1:])\n"
    )
    (folder / "words.py").write_text("HELLO = 'hello'\n")
    return folder.parent


def output(command: list[str], cwd: Path, package: Path) -> str:
    """What a command prints."""
    environment = {**os.environ, "PYTHONPATH": str(package)}
    environment.pop("PYTHONSAFEPATH", None)
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_module_is_run_from_a_hostile_folder(hostile_folder: Path, package: Path) -> None:
    """Found on PYTHONPATH, with its arguments, and its name in the command line."""
    command = python_command("greeting", "a", "-b")
    assert "greeting" in command
    assert output(command, hostile_folder, package) == "hello a -b"


@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12", "3.13"])
def test_every_python(version: str, hostile_folder: Path, package: Path) -> None:
    """By the command that the version itself would make; 3.10 has no option for it."""
    python = shutil.which(f"python{version}")
    if python is None or subprocess.run([python, "-c", ""], capture_output=True).returncode:
        pytest.skip(f"there is no Python {version}")
    source = Path(child_process.__file__)
    code = (
        "import runpy, json\n"
        f"command = runpy.run_path({str(source)!r})['python_command']('greeting', 'a')\n"
        "print(json.dumps(command))\n"
    )
    made = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True)
    assert output(json.loads(made.stdout), hostile_folder, package) == "hello a"


def test_without_the_option(hostile_folder: Path, package: Path) -> None:
    """The way of Python 3.10 works everywhere, also where the option is set already."""
    command = [sys.executable, "-c", child_process._RUN_MODULE, "greeting", "a"]
    assert output(command, hostile_folder, package) == "hello a"
