"""A real service and a real browser that tolerates no error, no foreign host, no broken policy."""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import trimesh
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from tests.live_service import LiveService, free_port
from tests.patience import PAGE_PATIENCE, patient

ROOT = Path(__file__).resolve().parents[2]
WEB = ROOT / "server" / "web"
AXE = WEB / "node_modules" / "axe-core" / "axe.min.js"

FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]

LAUNCHER = """#!/bin/sh
if [ -w /proc/self/autogroup ] && [ "$(cut -d ' ' -f 6 /proc/$$/stat)" = $$ ]; then
  echo 19 > /proc/self/autogroup
fi
exec {command} "$@"
"""


@pytest.fixture(scope="session")
def new_service(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[..., LiveService]]:
    """Starts services with nothing in them."""
    if not (WEB / "dist" / "index.html").is_file():
        pytest.fail("The page is not built. Run `make page` first.")
    started: list[LiveService] = []

    def start(workers: int = 1) -> LiveService:
        service = LiveService(tmp_path_factory.mktemp("service"), free_port(), workers)
        started.append(service)
        service.start()
        return service

    yield start
    for service in started:
        service.stop()


@pytest.fixture(scope="session")
def service(new_service: Callable[..., LiveService]) -> LiveService:
    """One service for all tests that do not mind the jobs of others."""
    return new_service()


@pytest.fixture
def queue_goes_on(service: LiveService) -> Iterator[None]:
    """A test that pauses the queue leaves it as it was, however it ends."""
    yield
    service.unpause_queue()


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Chromium without a window, drawing WebGL in software.

    It takes the cores that jobs leave, whose engines are nice themselves: otherwise a page that
    shows a job draws one picture after the other and keeps the job from its next frame. Root's
    Chromium would raise its priority, so it is not allowed to. Where Linux shares the processor out
    among sessions (autogroup), it is the session that has to be nice: Playwright starts one.
    """
    path = os.environ.get("MORPH_CHROMIUM") or shutil.which("chromium")
    if path is None:
        pytest.fail("There is no chromium. Install it, or name it in MORPH_CHROMIUM.")
    start = ["nice", "-n", "19", path]
    if os.geteuid() == 0 and (setpriv := shutil.which("setpriv")):
        start = [setpriv, "--inh-caps=-sys_nice", "--bounding-set=-sys_nice", *start]
    launcher = tmp_path_factory.mktemp("browser") / "chromium"
    launcher.write_text(LAUNCHER.format(command=shlex.join(start)))
    launcher.chmod(0o755)
    expect.set_options(timeout=PAGE_PATIENCE)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=launcher, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def new_page(browser: Browser, service: LiveService) -> Iterator[Callable[..., Page]]:
    """Opens pages, each in a browser profile of its own, that may do nothing wrong.

    Its arguments are those of Playwright's `new_context`, and `of`, another service.
    """
    faults: list[str] = []
    contexts: list[BrowserContext] = []

    def open_page(*, of: LiveService = service, **options: Any) -> Page:
        options = {"viewport": {"width": 1400, "height": 900}, "base_url": of.url} | options
        context = patient(browser.new_context(**options))
        contexts.append(context)
        _watch(context, of, faults)
        return context.new_page()

    yield open_page
    for context in contexts:
        context.close()
    assert faults == []


@pytest.fixture
def page(new_page: Callable[..., Page]) -> Page:
    """A page of 1400 x 900 pixels."""
    return new_page()


@pytest.fixture
def serious_faults() -> Callable[[Page], list[str]]:
    """What axe-core finds on a page that is serious or critical, one line each."""
    script = AXE.read_text(encoding="utf-8")

    def find(page: Page) -> list[str]:
        page.evaluate(script)
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        return [
            f"{rule['id']}: {node['html'][:200]} ({node['failureSummary']})"
            for rule in found["violations"]
            if rule["impact"] in ("serious", "critical")
            for node in rule["nodes"]
        ]

    return find


@pytest.fixture(scope="session")
def mesh_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Mesh files: a ball and two boxes of usual size, a pebble far off, a sheet with no volume."""
    folder = tmp_path_factory.mktemp("meshes")
    shapes = {
        "ball.obj": trimesh.creation.icosphere(subdivisions=2, radius=6.0),
        "crate.obj": trimesh.creation.box((8.0, 9.0, 7.0)),
        "box.stl": trimesh.creation.box((9.0, 9.0, 9.0)),
        "pebble.obj": trimesh.creation.icosphere(subdivisions=2, radius=1.4),
        "sheet.obj": trimesh.Trimesh([[0, 0, 0], [5, 0, 0], [0, 5, 0]], [[0, 1, 2]]),
    }
    shapes["pebble.obj"].apply_translation((300.0, -20.0, 5.0))
    for name, mesh in shapes.items():
        mesh.export(folder / name)
    return {name: folder / name for name in shapes}


def _watch(context: BrowserContext, service: LiveService, faults: list[str]) -> None:
    """Note errors in the console, breaches of the policy and requests to other hosts."""

    def hear(message: Any) -> None:
        # The page shows refusals of the API as sentences; the browser logs them as well.
        answer = message.text.startswith("Failed to load resource")
        if message.type == "error" and not (answer and _own(message.location["url"])):
            faults.append(f"{message.text} at {message.location}")

    def _own(url: str) -> bool:
        path = urlsplit(url).path
        return url.startswith(service.url) and path.startswith(("/v1/", "/readyz", "/nothing/"))

    def look(request: Any) -> None:
        if not request.url.startswith((service.url, "blob:", "data:")):
            faults.append(f"a request to {request.url}")

    context.on("console", hear)
    context.on("weberror", lambda error: faults.append(str(error.error)))
    context.on("request", look)
