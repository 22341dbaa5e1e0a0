"""Errors of the library and of the service are read on the page, too, which has no options."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from chamfer_morph.cli.output import in_flags

ROOT = Path(__file__).parents[2]
OPTION = re.compile(r"(?<![\w-])--[a-z]")


def words_of_errors(source: str) -> Iterator[str]:
    """The texts in every call of a class whose name ends in Error or Problem, or of a remedy."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            if name.endswith(("Error", "Problem")):
                for inner in ast.walk(node):
                    if isinstance(inner, ast.Constant) and isinstance(inner.value, str):
                        yield inner.value


@pytest.mark.parametrize("folder", ["morph_engine", "worker", "server", "schemas"])
def test_errors_name_no_options_of_the_command(folder):
    """Settings and parameters stand in backticks; only the command calls them options."""
    starts_the_service = ROOT / "server" / "auth.py"  # read in the terminal that starts it
    found = [
        f"{path.relative_to(ROOT)}: {text}"
        for path in (ROOT / folder).rglob("*.py")
        if path != starts_the_service
        for text in words_of_errors(path.read_text(encoding="utf-8"))
        if OPTION.search(text)
    ]
    assert not found


def test_the_page_names_no_options():
    """Nothing that the page says has two hyphens before a word; names of colours do."""
    for path in (ROOT / "server" / "web" / "src").rglob("*.js"):
        text = re.sub(r"(?s)/\*.*?\*/", "", path.read_text(encoding="utf-8"))
        text = re.sub(r"colour\([`\"]--[^)]*\)", "", text)
        assert not re.search(r"[\"'`][^\"'`\n]*(?<![\w-])--[a-z]", text), path


def test_the_command_names_its_options():
    """What stands in backticks becomes an option where there is one."""
    assert (
        in_flags("Set `sampling.fit` to auto; see `grid.dx`.")
        == "Set --fit to auto; see `grid.dx`."
    )
