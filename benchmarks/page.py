"""How soon the page shows a large job: `python -m benchmarks.page`.

Needs chromium and the built page (make page). A job of 89k particles and 40 frames is computed
first, which takes a minute; then its page is opened in new browser profiles, three times.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
import time
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from statistics import median

import psutil
from playwright.sync_api import Browser, expect, sync_playwright

from benchmarks.__main__ import machine
from client.api import MorphClient
from examples.service_demo import serving

FRAMES = 40
ROUNDS = 3
SHOWN = re.compile(f"^Frame {FRAMES} of {FRAMES}")
PATIENCE = 60_000
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
BARS = (1.0, 5.0, 400.0)


@dataclass(frozen=True)
class Opening:
    """What it took to open the page of a job.

    Attributes:
        first: Until a frame is drawn [s].
        whole: Until all frames are here [s].
        memory: Memory of the page's process that it shares with no other [MB].
    """

    first: float
    whole: float
    memory: float


def opening(browser: Browser, address: str) -> Opening:
    """Open the page of a job in a profile without a cache."""
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    page = context.new_page()
    arrived: list[float] = []
    page.on(
        "requestfinished",
        lambda request: "/frames/" in request.url and arrived.append(time.perf_counter()),
    )
    start = time.perf_counter()
    page.goto(address, wait_until="commit")
    expect(page.locator(".scene canvas")).to_have_attribute("aria-label", SHOWN)
    first = time.perf_counter() - start
    while len(arrived) < FRAMES:
        page.wait_for_timeout(20)
    whole = arrived[-1] - start
    memory = max(
        process.memory_full_info().uss
        for process in psutil.Process().children(recursive=True)
        if "--type=renderer" in " ".join(process.cmdline())
    )
    context.close()
    return Opening(first, whole, memory / 1e6)


def main() -> int:
    """Measure and print.

    Returns:
        Exit status: the number of figures above their bar.
    """
    chromium = os.environ.get("MORPH_CHROMIUM") or shutil.which("chromium")
    if chromium is None:
        sys.exit("There is no chromium. Install it, or name it in MORPH_CHROMIUM.")
    expect.set_options(timeout=PATIENCE)
    with (
        tempfile.TemporaryDirectory() as data,
        serving(Path(data)) as server,
        MorphClient(server) as client,
        sync_playwright() as playwright,
    ):
        overrides = {"sampling.points_per_cell_edge": 4}
        job = client.submit("sphere", "star", frames=FRAMES, overrides=overrides)
        for event in client.events(job.id):
            sys.stderr.write(f"\r{event.type} {event.data.get('frame', '')}   ")
        sys.stderr.write("\n")
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        rounds = [opening(browser, f"{server}/jobs/{job.id}") for _ in range(ROUNDS)]
        browser.close()
    print(f"{machine()}, {ROUNDS} openings, drawn in software\n")
    above = 0
    for field, bar, values in zip(
        fields(Opening), BARS, zip(*map(astuple, rounds), strict=True), strict=True
    ):
        least, middle, most = min(values), median(values), max(values)
        above += middle > bar
        unit = "MB" if field.name == "memory" else "s"
        print(f"{field.name:8} {least:7.2f} {middle:7.2f} {most:7.2f} {unit:3} bar {bar:g}")
    return above


if __name__ == "__main__":
    sys.exit(main())
