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
COMMANDS = (("npm", "ci"), ("npm", "run", "build"))


class BuildHook(BuildHookInterface[Any]):
    """Builds the page in `server/web`, and links the folders that an editable install consists of.

    Without Node.js the page that came with the sources, if any, is packed as it is.
    """

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page and, for an editable install, the links.

        Args:
            version: `standard`, or `editable` for an installation that points here; that one does
                without the page where it cannot be built.
            build_data: Hatchling's own.

        Raises:
            RuntimeError: Node.js is there and fails.
        """
        if version == "editable":
            self._link_subpackages()
        web = Path(self.root) / "server" / "web"
        if not (web / "package.json").is_file():
            return
        if not _node_is_there():
            if not (web / "dist" / "index.html").is_file():
                self.app.display_warning(
                    "The web page is not built, for there is no Node.js 20.19 or newer; the rest "
                    "works without it. Install Node.js with npm, then run `make page`."
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
                if version != "editable":
                    raise RuntimeError(message)
                self.app.display_warning(message)
                return

    def _link_subpackages(self) -> None:
        """Link chamfer_morph/server to server and so on: git has these links, an sdist has not."""
        for folder, package in self.build_config.sources.items():
            link = Path(self.root, package)
            if not os.path.lexists(link):
                with suppress(OSError):  # as on Windows; chamfer_morph/__init__.py helps itself
                    link.symlink_to(Path(os.path.relpath(folder, link.parent.name)))


def _node_is_there() -> bool:
    node = shutil.which("node")
    if node is None or shutil.which("npm") is None:
        return False
    answer = subprocess.run([node, "--version"], capture_output=True, text=True, check=False)
    found = re.match(r"v(\d+)\.(\d+)", answer.stdout)
    return bool(found) and tuple(map(int, found.groups())) >= OLDEST_NODE
