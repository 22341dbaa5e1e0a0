"""Every view of the web page, by day and by night, on a desk and on a phone."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from PIL import Image
from playwright.sync_api import Browser, FilePayload, Page, expect

from chamfer_morph.client import MorphClient
from docs.pictures.browsing import PATIENCE, browsing

WIDTHS = {"desk": (1400, 900), "phone": (390, 844)}
Scheme = Literal["light", "dark"]
SCHEMES: tuple[Scheme, ...] = ("light", "dark")
METHODS = ("flow", "joint", "physics", "dco")
SHOWN = (("star", "torus"), ("torus", "teapot"), ("teapot", "heart"), ("heart", "text:MPM"))
"""Pairs of shapes that the gallery has beside the morphs by these methods."""

HOPELESS = {"watchdog.restarts": 0, "watchdog.cells_per_step": 0.05}
"""Settings that let particles go no faster than they go in the middle of a morph."""

SETTLED = 1500
"""After this long [ms] a scene is drawn in full."""

QUALITY = 82

FRAMES = 40
COARSE = {"sampling.points_per_cell_edge": 2}

LAST_FRAME = re.compile(f"^Frame {FRAMES} of {FRAMES}, ")


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


def page_pictures(folder: Path, names: Collection[str] = ()) -> None:
    """Start a service, have it morph, and write a picture of each view.

    Args:
        folder: Where `VIEW-WIDTH-SCHEME.webp` are written.
        names: Of the views that are drawn; all if there are none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with browsing() as there:
        for view in _views(there.client, *_jobs(there.client)):
            if names and view.name not in names:
                continue
            for width in WIDTHS:
                for scheme in SCHEMES:
                    image = _picture(there.browser, there.server, view, width, scheme)
                    image.save(folder / f"{view.name}-{width}-{scheme}.webp", quality=QUALITY)
            print(view.name)


def _jobs(client: MorphClient) -> tuple[list[str], str]:
    """Morphs that are worth looking at, finished, and one that failed.

    Others are stopped, running and waiting.
    """
    finished = [
        client.submit(
            "sphere", "heart", method=method, name=f"heart, {method}", overrides=COARSE
        ).id
        for method in METHODS
    ]
    failed = client.submit(
        "sphere", "star", method="physics", name="star, too fast", overrides=COARSE | HOPELESS
    ).id
    others = [client.submit(source, target, overrides=COARSE).id for source, target in SHOWN]
    for job in [*finished, failed, *others]:
        for event in client.events(job):
            if event.type == "state":
                print(f"{job}: {event.data['state']}")
    stopped = client.submit("star", "torus", name="stopped half way", overrides=COARSE).id
    for event in client.events(stopped):
        if event.type == "frame" and event.data["frame"] == FRAMES // 2:
            client.cancel(stopped)
    for name in ("running for long", "waiting"):
        client.submit("teapot", "text:MPM", name=name, frames=1000)
    return finished, failed


def _views(client: MorphClient, jobs: list[str], failed: str) -> tuple[View, ...]:
    there = _scenes_are_there(1)
    job = f"/jobs/{jobs[0]}?frame={FRAMES}&quality=full"
    sheets = tuple(
        View(sheet, f"{job}&details={sheet}", there)
        for sheet in ("overview", "curves", "settings", "files")
    )
    pair = "/new?source=shape:sphere&target=shape:text:MPM"
    return (
        View("jobs", "/", _jobs_are_there),
        View("new", pair, _previews_are_there),
        View("job", job, there),
        View("gallery", "/gallery", _stills_are_there),
        View("compare", f"/compare?jobs={','.join(jobs)}&quality=full", _scenes_are_there(4)),
        *sheets,
        View(
            "failed",
            f"/jobs/{failed}?frame={FRAMES}&details=overview&quality=full",
            _failure_is_told,
        ),
        View("share", f"{job}&details=overview", _link_is_made(client, jobs[0])),
        View("display", job, _display_is_open),
        View("keys", job, _keys_are_listed),
        View("refused", pair, _mesh_is_refused),
        View("placed", "/new?source=shape:teapot&target=shape:heart", _shapes_are_placed),
        View("research", pair, _research_is_open),
    )


def _link_is_made(client: MorphClient, job: str) -> Callable[[Page], None]:
    def make(page: Page) -> None:
        for link in client.share_links(job):
            client.revoke_share_link(job, link.id)
        page.reload()
        _scenes_are_there(1)(page)
        page.get_by_role("button", name="Make a link").click()
        expect(page.get_by_label("Address of the link")).to_be_visible()
        page.locator(".sharing").scroll_into_view_if_needed()

    return make


def _failure_is_told(page: Page) -> None:
    expect(page.locator(".headline")).to_contain_text("cannot continue")
    canvas = page.locator(".scene canvas")
    expect(canvas).to_have_attribute("aria-label", re.compile("^Frame "))
    expect(page.locator(".surface-words")).to_contain_text("from the target")
    expect(canvas).not_to_have_attribute("aria-busy", "true")


def _display_is_open(page: Page) -> None:
    _scenes_are_there(1)(page)
    if not page.locator(".display").is_visible():
        page.keyboard.press("t")
    page.get_by_label("Cut", exact=True).select_option("z")
    page.get_by_label("Pace", exact=True).select_option("in-out")
    expect(page.get_by_label("Repeat")).to_be_visible()


def _keys_are_listed(page: Page) -> None:
    _scenes_are_there(1)(page)
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_be_visible()


def _mesh_is_refused(page: Page) -> None:
    _previews_are_there(page)
    sheet = b"v 0 0 0\nv 5 0 0\nv 0 5 0\nf 1 2 3\n"
    file = FilePayload(name="sheet.obj", mimeType="text/plain", buffer=sheet)
    card = page.get_by_role("region", name="From", exact=True)
    card.get_by_label("Mesh file of the source").set_input_files(file)
    expect(card.get_by_role("alert").filter(has_text="sheet.obj")).to_be_visible()


def _shapes_are_placed(page: Page) -> None:
    """Two pairs of landmarks, and handles that turn the source."""
    _previews_are_there(page)
    landmarks = page.get_by_role("region", name="Landmarks")
    pick = landmarks.get_by_role("button", name="Pick in the views")
    pick.click()
    for across in (-20, 20):
        for label in ("From", "To"):
            canvas = page.get_by_role("region", name=label, exact=True).locator("canvas")
            canvas.scroll_into_view_if_needed()
            box = canvas.bounding_box()
            assert box is not None
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            page.mouse.click(x + across, y)
    expect(landmarks.get_by_role("listitem")).to_have_count(2)
    pick.click()
    source = page.get_by_role("region", name="From", exact=True)
    source.get_by_text("Rotate and move").click()
    source.get_by_role("button", name="Rotate", exact=True).click()
    page.mouse.move(0, 0)


def _research_is_open(page: Page) -> None:
    _previews_are_there(page)
    page.get_by_text("Research", exact=True).click()
    expect(page.get_by_label("Preset", exact=True)).to_be_visible()


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
            expect(page.locator(".surface-words").nth(index)).to_contain_text("from the target")
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
    expect(page.get_by_text("does not support 3D graphics")).to_have_count(0)
    page.wait_for_timeout(SETTLED)
    height = page.evaluate("document.documentElement.scrollHeight")
    page.set_viewport_size({"width": horizontal, "height": height})  # what sticks is at the bottom
    page.wait_for_timeout(SETTLED)
    image = Image.open(io.BytesIO(page.screenshot(full_page=True)))
    context.close()
    return image.convert("RGB")
