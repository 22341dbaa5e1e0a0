"""docs/architecture.md is a map of the files as they are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGES = ("morph_engine", "schemas", "worker", "server", "client", "cli", "reproduction")


def section(title: str) -> str:
    """The text under a heading."""
    return re.split(r"^## ", TEXT.partition(f"## {title}\n")[2], maxsplit=1, flags=re.M)[0]


def map_of(package: str) -> str:
    """What the map says of a package."""
    return section("client and cli" if package in ("client", "cli") else package)


def test_where_is_names_files_that_exist():
    """At least twenty ideas, each with its file."""
    rows = re.findall(r"^\| (?!idea|---)(.+?) \| (.+?) \|$", section("Where is ...?"), re.M)
    assert len(rows) >= 20
    for idea, files in rows:
        for path in re.findall(r"`(.+?)`", files):
            assert (ROOT / path).exists(), (idea, path)


@pytest.mark.parametrize("package", PACKAGES)
def test_each_module_is_on_the_map(package):
    """By its own name or by its folder's."""
    missing = []
    for path in (ROOT / package).rglob("*.py"):
        relative = path.relative_to(ROOT / package)
        if "node_modules" in path.parts or path.name.startswith("__"):
            continue
        names = {path.name, relative.as_posix(), f"{package}/{relative.as_posix()}"}
        for folder in relative.parents[:-1]:
            names |= {f"{folder.as_posix()}/", f"{package}/{folder.as_posix()}/"}
        if not any(f"`{name}`" in map_of(package) for name in names):
            missing.append(relative.as_posix())
    assert not missing


@pytest.mark.parametrize("package", PACKAGES)
def test_the_map_names_no_module_that_is_gone(package):
    """A file that was renamed is renamed on the map."""
    modules = {path.name for path in (ROOT / package).rglob("*.py")}
    if package in ("client", "cli"):
        modules = {
            path.name for folder in ("client", "cli") for path in (ROOT / folder).glob("*.py")
        }
    named = re.findall(r"`(?:[\w/]+/)?(\w+\.py)`", map_of(package))
    assert set(named) <= modules
