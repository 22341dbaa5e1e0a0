"""The six looks, those of the page above those of `morph render`."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from playwright.sync_api import Page, ViewportSize, expect

from docs.pictures.browsing import browsing
from docs.pictures.page import QUALITY
from morph_engine.rendering.camera_path import CameraKey, CameraPath, View
from morph_engine.rendering.materials import MATERIALS
from morph_engine.rendering.pictures import video

WIDTH, HEIGHT = 1200, 1000
CELL = (300, 270)
LABEL_HEIGHT = 30
FRAMES = 8

EYE = CameraPath(keys=(CameraKey(0.0, View(math.degrees(math.atan2(0.5, 1)), 17.4)),))
"""Where the page's usual view is from."""

AROUND = 0.16
"""Space that is left around the shape, over its size."""


def looks(folder: Path) -> None:
    """Write `looks.webp`.

    Args:
        folder: Where it is written.
    """
    with browsing() as there:
        job = there.client.submit("sphere", "teapot", frames=FRAMES).id
        there.client.wait(job)
        result = there.data / "teapot.vtkhdf"
        there.client.download(job, result)
        size: ViewportSize = {"width": WIDTH, "height": HEIGHT}
        page = there.browser.new_page(base_url=there.server, viewport=size)
        shown = {name: _in_page(page, job, name) for name in MATERIALS}
        behind = np.asarray(shown["clay"])[HEIGHT // 2, 5].tobytes().hex()
        drawn = {name: _rendered(result, name, f"#{behind}") for name in MATERIALS}
    rows = [_cropped(pictures) for pictures in (shown, drawn)]
    _sheet(rows).save(folder / "looks.webp", quality=QUALITY)


def _in_page(page: Page, job: str, name: str) -> Image.Image:
    """The last frame at full quality, without what floats over it."""
    page.goto(f"/jobs/{job}?frame={FRAMES}&quality=full&look={name}")
    expect(page.locator(".surface-words")).to_contain_text("from the target")
    frame = page.locator(".scene-frame")
    frame.evaluate("frame => { frame.style.zIndex = 9; }")
    page.wait_for_timeout(1000)
    expect(frame.locator("canvas")).not_to_have_attribute("aria-busy", "true")
    return Image.open(io.BytesIO(frame.screenshot())).convert("RGB")


def _rendered(result: Path, name: str, background: str) -> Image.Image:
    """The same by `morph render`."""
    path = result.with_name(f"{name}.png")
    size = (WIDTH, HEIGHT)
    video(result, path, surface=True, material=name, background=background, camera=EYE, size=size)
    return Image.open(path).convert("RGB")


def _cropped(pictures: dict[str, Image.Image]) -> list[Image.Image]:
    """Cells with the shape in the middle, which is where clay is redder than all around it."""
    rgb = np.asarray(pictures["clay"], int)
    inside = rgb[..., 0] - rgb[..., 2] > 20
    rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    width, height = np.ptp(columns), np.ptp(rows)
    scale = (1 + 2 * AROUND) * max(width / CELL[0], height / CELL[1])
    x, y = (columns[0] + columns[-1]) / 2, (rows[0] + rows[-1]) / 2
    across, down = scale * CELL[0] / 2, scale * CELL[1] / 2
    box = (x - across, y - down, x + across, y + down)
    return [one.resize(CELL, Image.Resampling.LANCZOS, box) for one in pictures.values()]


def _sheet(rows: list[list[Image.Image]]) -> Image.Image:
    width, height = CELL
    sheet = Image.new("RGB", (width * len(MATERIALS), LABEL_HEIGHT + height * len(rows)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for column, name in enumerate(MATERIALS):
        middle = (column * width + width / 2, LABEL_HEIGHT / 2)
        draw.text(middle, name, fill="black", font=font, anchor="mm")
        for row, cells in enumerate(rows):
            sheet.paste(cells[column], (column * width, LABEL_HEIGHT + row * height))
    for row, words in enumerate(("in the page", "morph render")):
        draw.text((8, LABEL_HEIGHT + row * height + 6), words, fill="#556", font=font)
    return sheet
