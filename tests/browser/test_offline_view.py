"""`morph view`: one file that shows a morph without a service and without a network."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from morph_engine.results.trajectory import Trajectory
from tests.patience import patient

pytestmark = pytest.mark.browser

MORPH = Path(sys.executable).with_name("morph")
FRAMES = 8


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball that becomes a star."""
    out = tmp_path_factory.mktemp("morph") / "star.vtkhdf"
    subprocess.run(
        [MORPH, "run", "sphere", "star", "--points-per-cell-edge", "2", "--frames", str(FRAMES),
         "--quiet", "--out", out],
        check=True,
    )  # fmt: skip
    return out


@pytest.fixture
def open_file(browser: Browser) -> Iterator[Callable[[Path], Page]]:
    """Opens a file in a browser that reaches no network and tolerates no error."""
    faults: list[str] = []
    context = browser.new_context(viewport={"width": 900, "height": 600}, offline=True)
    context.on("console", lambda message: message.type == "error" and faults.append(message.text))
    context.on("weberror", lambda error: faults.append(str(error.error)))

    def open_(path: Path) -> Page:
        page = patient(context.new_page())
        page.goto(path.as_uri())
        return page

    yield open_
    context.close()
    assert faults == []


def picture(page: Page) -> np.ndarray:
    """What is drawn, once it is at rest; shape [h, w, 3]."""
    page.wait_for_timeout(1500)
    shot = page.locator("canvas").screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), np.int16)


def differs(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that look another."""
    return float((np.abs(one - other).max(axis=2) > 24).mean())


def test_a_page_with_particles_and_surface(
    result: Path, tmp_path: Path, open_file: Callable[[Path], Page]
) -> None:
    """It shows the surface, as that is quick, or particles; it plays, and is worked by keys."""
    out = tmp_path / "star.html"
    subprocess.run([MORPH, "view", result, "--no-browser", "--quiet", "--out", out], check=True)
    assert out.stat().st_size < 15e6
    page = open_file(out)
    page.wait_for_selector("body[data-ready]")
    expect(page.get_by_role("heading", name="sphere to star")).to_be_visible()
    expect(page.get_by_label("Show as")).to_have_value("surface")
    first = picture(page)
    assert differs(first, np.broadcast_to(first[5, 5], first.shape)) > 0.1
    page.keyboard.press("Shift+ArrowRight")
    expect(page.get_by_text(f"{FRAMES} / {FRAMES}")).to_be_visible()
    last = picture(page)
    assert differs(first, last) > 0.02
    page.keyboard.press("p")
    expect(page.get_by_label("Show as")).to_have_value("points")
    assert differs(last, picture(page)) > 0.01
    page.keyboard.press(" ")
    expect(page.get_by_text(f"3 / {FRAMES}")).to_be_visible()
    page.get_by_label("Look").select_option("metal")


def test_a_page_plays_in_a_time_of_its_own(
    result: Path, tmp_path: Path, open_file: Callable[[Path], Page]
) -> None:
    """There and back, with a rest at the end, and no speed to be chosen."""
    out = tmp_path / "star.html"
    subprocess.run(
        [MORPH, "export", result, "--out", out, "--seconds", "8", "--hold", "2", "--easing",
         "linear", "--repeat", "ping-pong", "--quiet"],
        check=True,
    )  # fmt: skip
    page = open_file(out)
    page.wait_for_selector("body[data-ready]")
    expect(page.get_by_label("Speed")).to_be_hidden()
    expect(page.get_by_text(f"1 / {FRAMES}")).to_be_visible()
    page.keyboard.press(" ")
    expect(page.get_by_text(f"{FRAMES} / {FRAMES}")).to_be_visible(timeout=600_000)
    expect(page.get_by_text(f"1 / {FRAMES}")).to_be_visible(timeout=600_000)


def test_a_notebook_shows_a_trajectory(
    result: Path, tmp_path: Path, open_file: Callable[[Path], Page]
) -> None:
    """What it displays is a viewer in a frame of its own."""
    with Trajectory(result) as trajectory:
        cell = trajectory._repr_html_()
    assert cell is not None and len(cell) < 5e6
    notebook = tmp_path / "notebook.html"
    notebook.write_text(f"<!doctype html><title>Notebook</title>{cell}", encoding="utf-8")
    frame = open_file(notebook).frame_locator("iframe")
    frame.locator("body[data-ready]").wait_for()
    expect(frame.get_by_text(f"1 / {FRAMES}")).to_be_visible()
