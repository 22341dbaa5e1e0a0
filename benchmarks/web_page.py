"""How soon the page is there and shows a large job: `python -m benchmarks.web_page [--record]`.

Needs chromium and the built page (make page). A job of 89k particles and 40 frames is computed
first, which takes a minute; then the list of jobs and the job are opened in new browser profiles,
three times. A job of 38k particles, and its surface, are then turned while they play, and pictures
are counted.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
import tempfile
import time
from dataclasses import astuple, dataclass
from pathlib import Path
from statistics import median

import psutil
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from benchmarks import history
from benchmarks.record import machine
from benchmarks.service.measurement import Measurement, least, table
from chamfer_morph.client import MorphClient
from examples.service_demo import serving

FRAMES = 40
ROUNDS = 3
NOTE_THE_TIMES = """
const look = () => {
  const label = document.querySelector(".scene canvas")?.getAttribute("aria-label") ?? "";
  if (label.startsWith("Frame ")) window.drawn ??= performance.now();
  if (document.querySelector("a.thumbnail")) window.listed ??= performance.now();
  requestAnimationFrame(look);
};
look();
for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    window.drawing = true;
    return draw.apply(this, given);
  };
}
window.pictures = 0;
const count = () => {
  window.pictures += window.drawing ? 1 : 0;
  window.drawing = false;
  requestAnimationFrame(count);
};
count();
"""
"""Runs beside the page; times are in ms since the navigation began. `pictures` counts those that
the page has drawn."""

PATIENCE = 60_000
SETTLED = 1500
"""After this long [ms] a scene is drawn in full."""

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
OPENED = (
    ("page: list of jobs", 2.0, "s"),
    ("page, 89k particles: first frame drawn", 1.0, "s"),
    ("page, 89k particles: all frames there", 5.0, "s"),
    ("page, 89k particles: memory", 400.0, "MB"),
)
"""Name, bar and unit of each number of an `Opening`."""

TURNED = {
    "points": "page, 38k particles turned while they play",
    "surface": "page, their surface turned while it plays",
}
LEAST_RATE = 10.0
"""Pictures a second where no GPU draws them."""

TURNING = 6.0
"""How long a morph is turned while it plays [s]."""


@dataclass(frozen=True)
class Opening:
    """What it took to open the page.

    Attributes:
        list: Until the list of jobs is there and the page idle [s].
        first: Until a frame of the job is drawn [s].
        whole: Until all of its frames are here [s].
        memory: Memory of the page's process that it shares with no other [MB].
    """

    list: float
    first: float
    whole: float
    memory: float


def opening(browser: Browser, server: str, job: str) -> Opening:
    """Open the list, and the page of a job, each in a profile without a cache."""
    context = _profile(browser)
    page = context.new_page()
    page.goto(server)
    listed = _noted(page, "listed")
    context.close()

    context = _profile(browser)
    page = context.new_page()
    page.goto(f"{server}/jobs/{job}")
    first = _noted(page, "drawn")
    ends = _ends("/frames/")
    while page.evaluate(f"{ends}.length") < FRAMES:
        page.wait_for_timeout(50)
    whole = page.evaluate(f"Math.max(...{ends}.map(one => one.responseEnd))") / 1000
    memory = max(
        process.memory_full_info().uss
        for process in psutil.Process().children(recursive=True)
        if "--type=renderer" in " ".join(process.cmdline())
    )
    context.close()
    return Opening(listed, first, whole, memory / 1e6)


def pictures_per_second(browser: Browser, server: str, job: str, shape: str) -> float:
    """How many pictures the page draws while a morph plays and is turned by the mouse.

    Args:
        browser: Draws them.
        server: Address of the service.
        job: A finished job.
        shape: ``points`` or ``surface``.
    """
    context = _profile(browser)
    page = context.new_page()
    page.goto(f"{server}/jobs/{job}?frame=1&shape={shape}")
    _noted(page, "drawn")
    page.wait_for_load_state("networkidle")
    page.wait_for_timeout(SETTLED)
    page.get_by_label("Loop").check()
    page.locator(".scene").focus()
    page.keyboard.press(" ")
    while shape == "surface" and page.evaluate(f"{_ends('/surface')}.length") < FRAMES:
        page.wait_for_timeout(50)
    page.mouse.move(500, 450)
    page.mouse.down()
    counted, begun = page.evaluate("window.pictures"), time.perf_counter()
    step = 0
    while (took := time.perf_counter() - begun) < TURNING:
        step += 1
        page.mouse.move(500 + 150 * math.sin(step / 20), 450)
    counted = page.evaluate("window.pictures") - counted
    context.close()
    return counted / took


def _ends(part: str) -> str:
    """JavaScript for what has been fetched from addresses with this part."""
    return f"performance.getEntriesByType('resource').filter(one => one.name.includes('{part}'))"


def _profile(browser: Browser) -> BrowserContext:
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    context.set_default_timeout(PATIENCE)
    context.add_init_script(NOTE_THE_TIMES)
    return context


def _noted(page: Page, name: str) -> float:
    """What the page noted [s], once it has."""
    while not (noted := page.evaluate(f"window.{name}")):
        page.wait_for_timeout(50)
    return noted / 1000


def main() -> int:
    """Measure and print.

    Returns:
        Exit status: the number of figures on the wrong side of their bar.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.web_page", description=__doc__)
    parser.add_argument("--record", action="store_true", help="add it to results/history.jsonl")
    options = parser.parse_args()
    chromium = os.environ.get("MORPH_CHROMIUM") or shutil.which("chromium")
    if chromium is None:
        sys.exit("There is no chromium. Install it, or name it in MORPH_CHROMIUM.")
    before = machine()
    with (
        tempfile.TemporaryDirectory() as data,
        serving(Path(data)) as server,
        MorphClient(server) as client,
        sync_playwright() as playwright,
    ):
        overrides = {"sampling.points_per_cell_edge": 4}
        job = client.submit("sphere", "star", frames=FRAMES, overrides=overrides)
        usual = client.submit("sphere", "star", frames=FRAMES)
        for each in (job, usual):
            for event in client.events(each.id):
                sys.stderr.write(f"\r{event.type} {event.data.get('frame', '')}   ")
            sys.stderr.write("\n")
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        rounds = [opening(browser, server, job.id) for _ in range(ROUNDS)]
        rates = {shape: pictures_per_second(browser, server, usual.id, shape) for shape in TURNED}
        browser.close()
        triangles = triangle_count(client.surface(usual.id, format="stl"))
    figures = []
    for (what, bar, unit), seen in zip(
        OPENED, zip(*map(astuple, rounds), strict=True), strict=True
    ):
        note = f"{min(seen):.2f} to {max(seen):.2f} {unit} in {ROUNDS} openings"
        figures.append(Measurement(what, median(seen), bar, unit, note))
    for shape, rate in rates.items():
        note = f"{triangles} triangles at the end" if shape == "surface" else ""
        figures.append(least(TURNED[shape], rate, LEAST_RATE, "pictures/s", note))
    if options.record:
        history.record(figures, drawn="in software", triangles=str(triangles))
    print(f"{before}, drawn in software\n\n{table(figures)}")
    return sum(figure.missed for figure in figures)


def triangle_count(stl: bytes) -> int:
    """Triangles of a binary STL file."""
    return int.from_bytes(stl[80:84], "little")


if __name__ == "__main__":
    sys.exit(main())
