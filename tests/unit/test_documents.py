"""Documents lead to files of the repository, and name the version that there is."""

from __future__ import annotations

import pkgutil
import re
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
NAME = re.compile(r"`((?:morph_engine|chamfer_morph)(?:\.\w+)+)`")
LOGGERS = {"chamfer_morph.audit", "chamfer_morph.jobs"}
LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]+)")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_link_leads_to_a_file(document):
    """Of the same repository; places on pages are checked where the site is built."""
    for link in LINK.findall(document.read_text(encoding="utf-8")):
        assert (document.parent / link).is_file(), link


@pytest.mark.parametrize(
    "name",
    sorted(
        {name for document in DOCUMENTS for name in NAME.findall(document.read_text("utf-8"))}
        - LOGGERS
    ),
)
def test_every_name_in_python_is_there(name):
    """Modules, and what is in them."""
    assert pkgutil.resolve_name(name) is not None


def test_the_citation_names_the_version():
    """What is cited is what is installed, and the changelog has it."""
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {version('chamfer-morph')}\n" in citation
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"\n## {version('chamfer-morph')}\n" in changes
