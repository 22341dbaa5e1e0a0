"""Every view of the web page, by day and by night, on a desk and on a phone."""

from __future__ import annotations

import io
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright

from chamfer_morph.client import MorphClient
from examples.service_demo import serving

WIDTHS = {"desk": (1400, 900), "phone": (390, 844)}
Scheme = Literal["light", "dark"]
SCHEMES: tuple[Scheme, ...] = ("light", "dark")
METHODS = ("flow", "joint", "physics", "dco")
SHOWN = (("star", "torus"), ("torus", "teapot"), ("teapot", "heart"), ("heart", "text:MPM"))
"""Pairs of shapes that the gallery has beside the morphs by these methods."""

PATIENCE = 120_000
"""How long a view may take to show all it has [ms]."""

SETTLED = 1500
"""After this long [ms] a scene is drawn in full."""

QUALITY = 82

LAST_FRAME = re.compile("^Frame 40 of 40, ")

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@dataclass(frozen=True)
class View:
    """A view of the page.

    Attributes:
        name: Stem of its pictures.
        path: Where it is.
        prepare: Brings it into the state that is worth a picture.
    """

    name: str
    path: str
    prepare: Callable[[Page], None]


def page_pictures(folder: Path) -> None:
    """Start a service, have it morph, and write a picture of each view.

    Args:
        folder: Where `VIEW-WIDTH-SCHEME.webp` are written.
    """
    chromium = os.environ.get("MORPH_CHROMIUM") or shutil.which("chromium")
    if chromium is None:
        sys.exit("There is no chromium. Install it, or name it in MORPH_CHROMIUM.")
    folder.mkdir(parents=True, exist_ok=True)
    expect.set_options(timeout=PATIENCE)
    with (
        tempfile.TemporaryDirectory() as data,
        serving(Path(data)) as server,
        MorphClient(server) as client,
        sync_playwright() as playwright,
    ):
        views = _views(_jobs(client))
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        for view in views:
            for width in WIDTHS:
                for scheme in SCHEMES:
                    image = _picture(browser, server, view, width, scheme)
                    image.save(folder / f"{view.name}-{width}-{scheme}.webp", quality=QUALITY)
        browser.close()


def _jobs(client: MorphClient) -> list[str]:
    """Morphs that are worth looking at, finished, and others that are running and waiting."""
    finished = [
        client.submit(
            "sphere",
            "heart",
            method=method,
            name=f"heart, {method}",
            overrides={"sampling.points_per_cell_edge": 2},
        ).id
        for method in METHODS
    ]
    others = [
        client.submit(source, target, overrides={"sampling.points_per_cell_edge": 2}).id
        for source, target in SHOWN
    ]
    for job in finished + others:
        for event in client.events(job):
            if event.type == "state":
                print(f"{job}: {event.data['state']}")
    stopped = client.submit("star", "torus", name="stopped half way", frames=1000).id
    client.cancel(stopped)
    for name in ("running for long", "waiting"):
        client.submit("teapot", "text:MPM", name=name, frames=1000)
    return finished


def _views(jobs: list[str]) -> tuple[View, ...]:
    return (
        View("jobs", "/", _jobs_are_there),
        View("new", "/new?source=shape:sphere&target=shape:text:MPM", _previews_are_there),
        View("job", f"/jobs/{jobs[0]}?frame=40", _scenes_are_there(1)),
        View("gallery", "/gallery", _stills_are_there),
        View("compare", f"/compare?jobs={','.join(jobs)}", _scenes_are_there(len(jobs))),
    )


def _jobs_are_there(page: Page) -> None:
    expect(page.get_by_role("link", name="waiting", exact=True)).to_be_visible()
    expect(page.locator(".thumbnail img").first).to_be_visible()


def _stills_are_there(page: Page) -> None:
    stills = page.locator("main img")
    expect(stills).to_have_count(len(METHODS) + len(SHOWN))
    for still in stills.all():
        still.scroll_into_view_if_needed()
        expect(still).to_have_js_property("complete", True)
    page.mouse.wheel(0, -100_000)


def _previews_are_there(page: Page) -> None:
    for label in ("From", "To"):
        card = page.get_by_role("region", name=label, exact=True)
        expect(card.get_by_role("status")).to_have_text(re.compile(r"\d particles"))


def _scenes_are_there(count: int) -> Callable[[Page], None]:
    def wait(page: Page) -> None:
        for index in range(count):
            canvas = page.locator(".scene canvas").nth(index)
            expect(canvas).to_have_attribute("aria-label", LAST_FRAME)
            expect(page.locator(".scene-note").nth(index)).to_contain_text("from the target")
            expect(canvas).not_to_have_attribute("aria-busy", "true")

    return wait


def _picture(browser: Browser, server: str, view: View, width: str, scheme: Scheme) -> Image.Image:
    horizontal, vertical = WIDTHS[width]
    context = browser.new_context(
        base_url=server,
        viewport={"width": horizontal, "height": vertical},
        color_scheme=scheme,
        has_touch=width == "phone",
    )
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    page.goto(view.path)
    view.prepare(page)
    page.wait_for_timeout(SETTLED)
    height = page.evaluate("document.documentElement.scrollHeight")
    page.set_viewport_size({"width": horizontal, "height": height})  # what sticks is at the bottom
    page.wait_for_timeout(SETTLED)
    image = Image.open(io.BytesIO(page.screenshot(full_page=True)))
    context.close()
    return image.convert("RGB")
