"""A service and a browser that looks at it, for pictures of the page."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Browser, expect, sync_playwright

from chamfer_morph.client import MorphClient
from examples.service_demo import serving

PATIENCE = 120_000
"""How long a view may take to show all it has [ms]."""

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@dataclass(frozen=True)
class Browsing:
    """A new service, for as long as it is needed.

    Attributes:
        data: A folder for files that go with it.
        server: Its address.
        client: Asks it.
        browser: Opens its pages.
    """

    data: Path
    server: str
    client: MorphClient
    browser: Browser


@contextmanager
def browsing() -> Iterator[Browsing]:
    """Start a service and a browser."""
    expect.set_options(timeout=PATIENCE)
    with (
        tempfile.TemporaryDirectory() as data,
        serving(Path(data)) as server,
        MorphClient(server) as client,
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=_chromium(), args=FLAGS) as browser,
    ):
        yield Browsing(Path(data), server, client, browser)


def _chromium() -> str:
    """Where the browser is; without one the program ends."""
    found = os.environ.get("MORPH_CHROMIUM") or shutil.which("chromium")
    return found or sys.exit("There is no chromium. Install it, or name it in MORPH_CHROMIUM.")
