"""What the site is built from: the documents, the repository's own pages, and references from code.

The documents stay as they are. A copy of them is made in which links between files of the
repository are links between pages of the site.
"""

from __future__ import annotations

import posixpath
import re
import shutil
from pathlib import Path

from docs.site import command_line, http_api, library, run_settings

ROOT = Path(__file__).resolve().parents[2]

COPIED = ("images", "results/figures", "results/tables")
PUBLISHED = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "CITATION.cff": "CITATION.cff",
    "LICENSE": "LICENSE",
    "openapi/openapi.json": "openapi.json",
}
"""Files outside docs/, and where the site has them."""

SECTIONS = {
    "Start": ("tutorial", "gallery", "faq", "glossary"),
    "How to": (
        "shapes", "exports", "paraview", "blender", "notebooks", "client", "page", "own_method",
    ),
    "Methods": ("method", "transport", "algorithm", "presets", "metrics"),
    "The paper": (
        "reproduction", "findings", "propositions", "results/README", "results/report",
        "results/headline", "results/fair", "results/transport", "results/presets",
    ),
    "Reference": (
        "reference/command_line", "reference/settings", *library.pages(), "api", "reference/http",
    ),
    "Operating": ("operating", "settings", "performance", "faults"),
    "About": ("architecture", "contributing", "changelog", "security", "citing"),
}  # fmt: skip
"""Every page but the first, under the headings of the list at the side."""

LINK = re.compile(r"(?<=\]\()(?![a-z]+:)[^)#\s]+")


def write_sources(folder: Path) -> None:
    """Write everything that Sphinx is to read into a folder that is not there yet."""
    for name in COPIED:
        shutil.copytree(ROOT / "docs" / name, folder / name)
    for path in ROOT.glob("docs/**/*.md"):
        name = path.relative_to(ROOT / "docs").as_posix()
        _write(folder / name, turned(path.read_text(encoding="utf-8"), f"docs/{name}", name))
    for origin, name in PUBLISHED.items():
        text = (ROOT / origin).read_text(encoding="utf-8")
        _write(folder / name, turned(text, origin, name) if name.endswith(".md") else text)
    references = {
        "reference/command_line": command_line.page(),
        "reference/http": http_api.page(),
        "reference/settings": run_settings.page(),
        **library.pages(),
    }
    for name, text in references.items():
        _write(folder / f"{name}.md", text)
    with (folder / "index.md").open("a", encoding="utf-8") as index:
        for title, names in SECTIONS.items():
            lines = ("```{toctree}", ":hidden:", f":caption: {title}", "", *names, "```")
            index.write("\n" + "\n".join(lines) + "\n")


def turned(text: str, origin: str, name: str) -> str:
    """A document with links as the site needs them.

    Args:
        text: The document.
        origin: Its path in the repository, which its links start from.
        name: Its path in the site.
    """

    def turn(link: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(origin), link[0]))
        target = PUBLISHED.get(path, path.removeprefix("docs/"))
        return posixpath.relpath(target, posixpath.dirname(name) or ".")

    return LINK.sub(turn, text)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
