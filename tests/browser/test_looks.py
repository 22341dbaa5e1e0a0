"""The named looks: the page's pictures beside those of `morph render`."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Page, expect

from morph_engine.rendering.materials import MATERIALS
from morph_engine.rendering.pictures import Camera, look, picture
from tests.color_difference import differences

pytestmark = pytest.mark.browser

SIZE = 480
CELLS = 24
"""Pictures are compared as so many cells along a side, from edge to edge of the shape."""


@pytest.fixture(scope="module")
def sculpture(service) -> str:
    """A job with a surface that has bulges and creases."""
    job = service.submit(target={"shape": "torus"}, frames=2, method="dco")
    service.wait_for(job, "succeeded", seconds=400)
    return job


def cells(shot: Image.Image, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean colours of cells of the box around a shape, and which of them it fills."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    box = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
    small = shot.convert("RGB").crop(box).resize((CELLS, CELLS), Image.Resampling.BOX)
    cover = (
        Image.fromarray(np.uint8(255 * inside)).crop(box).resize(small.size, Image.Resampling.BOX)
    )
    return np.asarray(small), np.asarray(cover) > 253


def take(page: Page, job: str, name: str) -> Image.Image:
    """The page's finest picture from the front, without what floats over it."""
    page.goto(f"/jobs/{job}?frame=2&quality=full&look={name}")
    expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    page.keyboard.press("1")
    frame = page.locator(".scene-frame")
    frame.evaluate("frame => { frame.style.zIndex = 9; }")
    page.wait_for_timeout(500)
    expect(frame.locator("canvas")).not_to_have_attribute("aria-busy", "true", timeout=120_000)
    return Image.open(io.BytesIO(frame.screenshot()))


@pytest.fixture(scope="module")
def surface(service, sculpture) -> trimesh.Trimesh:
    """That of the last frame [grid units]."""
    answer = service.call("GET", f"/v1/jobs/{sculpture}/frames/1/surface?format=ply&units=grid")
    return trimesh.load(io.BytesIO(answer.content), file_type="ply", process=False)


@pytest.fixture(scope="module")
def drawn(surface) -> Callable[..., np.ndarray]:
    """Draws it as `morph render` does, from the front."""
    return partial(
        picture, surface.vertices, spacing=1.0, faces=np.asarray(surface.faces, np.int32),
        view=Camera.facing(surface.vertices, look(azimuth=0, elevation=0), (SIZE, SIZE)),
        size=(SIZE, SIZE),
    )  # fmt: skip


@pytest.fixture(scope="module")
def outline(drawn) -> np.ndarray:
    """Where the shape is in those pictures."""
    return drawn(material="clay", background=None)[..., 3] > 127


@pytest.fixture(scope="module")
def pictures() -> dict[str, Image.Image]:
    """The page's by their looks, as far as they are taken."""
    return {}


@pytest.fixture
def shown(new_page, sculpture, pictures) -> Callable[[str], Image.Image]:
    """The page's picture in a look, on a small page: software takes seconds for each."""

    def find(name: str) -> Image.Image:
        if name not in pictures:
            page = new_page(viewport={"width": 1000, "height": 640})
            pictures[name] = take(page, sculpture, name)
        return pictures[name]

    return find


@pytest.fixture
def silhouette(shown) -> np.ndarray:
    """Where the shape is in the page's pictures: clay is redder than all around it."""
    rgb = np.asarray(shown("clay").convert("RGB"), np.float64)
    return rgb[..., 0] - rgb[..., 2] > 20


@pytest.mark.parametrize("name", MATERIALS)
def test_a_look_is_the_same_in_the_page_and_on_the_command_line(
    shown, silhouette, drawn, outline, name
):
    """CIE 1976 difference of the mean colours below 7, and of cells below 9 on the average.

    Reflections differ in their places, of metal most: the page has a room of boxes and an eye at a
    distance.
    """
    seen = shown(name)
    behind = np.asarray(seen.convert("RGB"))[5, seen.width // 2] / 255
    here, full = cells(seen, silhouette)
    there, also_full = cells(
        Image.fromarray(drawn(material=name, background=tuple(behind))), outline
    )
    both = full & also_full
    assert np.count_nonzero(both) > CELLS**2 / 3
    assert differences(here[both].mean(axis=0), there[both].mean(axis=0)) < 7
    assert differences(here[both], there[both]).mean() < (17 if name == "metal" else 9)
