"""An environment that has what the core of the package requires, and nothing of its extras."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

NAME = "chamfer-morph"

MOST_DISTRIBUTIONS = 30
"""That the core brings along."""


def core_distributions() -> set[str]:
    """Names of the distributions that `pip install chamfer-morph` installs beside it."""
    found = {(NAME, frozenset[str]())}
    waiting = list(found)
    while waiting:
        new = set(_required_by(*waiting.pop())) - found
        found |= new
        waiting += new
    return {name for name, _ in found} - {NAME}


def _required_by(name: str, extras: frozenset[str]) -> Iterator[tuple[str, frozenset[str]]]:
    """Names and extras of what a distribution with extras requires on this machine."""
    for required in map(Requirement, metadata.requires(name) or ()):
        marker = required.marker
        if not marker or any(marker.evaluate({"extra": extra}) for extra in extras or {""}):
            yield canonicalize_name(required.name), frozenset(required.extras)


def make_core_environment(folder: Path, *, with_project: bool) -> Path:
    """Make a virtual environment of what the core requires, as links to the packages that run this.

    Args:
        folder: Where it is made.
        with_project: Whether the project itself is in it, too, as it is installed here.

    Returns:
        Its Python.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    python = folder / "bin" / "python"
    site_packages = site_packages_of(python)
    for name in core_distributions() | ({NAME} if with_project else set()):
        distribution = metadata.distribution(name)
        entries = {file.parts[0] for file in distribution.files or ()}
        for entry in entries - {"..", "__pycache__"}:
            link = site_packages / entry
            if not link.is_symlink():  # some packages share a folder
                link.symlink_to(str(distribution.locate_file(entry)))
    return python


def site_packages_of(python: Path) -> Path:
    """Where the packages of an environment lie."""
    (found,) = python.parents[1].glob("lib/python*/site-packages")
    return found
