"""The colours of two textured meshes in the page, from those of the source to the target's."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Page, expect

from morph_engine.export import export
from tests.animated_pair import FPS
from tests.browser.test_animated_glb import playing, validated
from tests.browser.test_job_view import (
    COMPILING,
    changed,
    details,
    expect_frame,
    picture,
    saved,
)

pytestmark = pytest.mark.browser

FRAMES = 8


def textured_ball(path: Path, left: str, right: str) -> Path:
    """A ball with one colour at its left and another at its right, in a GLB file."""
    image = Image.new("RGB", (64, 64), left)
    image.paste(Image.new("RGB", (32, 64), right), (32, 0))
    ball = trimesh.creation.icosphere(subdivisions=4, radius=6.0)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    uv = (ball.vertices[:, :2] / 6 * 0.95 + 1) / 2
    ball.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    ball.export(path)
    return path


@pytest.fixture(scope="module")
def colored(service, tmp_path_factory) -> str:
    """A job from a ball in orange and blue to one in green and violet."""
    folder = tmp_path_factory.mktemp("colored")
    colors = {"source": ("#e08020", "#2050d0"), "target": ("#20b050", "#8030b0")}
    meshes = {}
    for role, pair in colors.items():
        data = textured_ball(folder / f"{role}.glb", *pair).read_bytes()
        answer = service.call("POST", f"/v1/meshes?name={role}.glb", content=data)
        assert answer.is_success, answer.text
        meshes[role] = {"mesh": answer.json()["id"]}
    job = service.submit(name="in colour", frames=FRAMES, method="dco", **meshes)
    service.wait_for(job, "succeeded", seconds=COMPILING)
    return job


def sides(page: Page) -> tuple[np.ndarray, np.ndarray]:
    """Median colour to the left and to the right of the middle of the shape, RGB."""
    pixels = np.asarray(picture(page), float)
    reach = len(pixels) // 8
    of_shape = np.nonzero(np.ptp(pixels, axis=2) > 25)  # all around it is nearly grey
    row, column = (int(np.median(along)) for along in of_shape)
    rows = pixels[row - reach // 2 : row + reach // 2]
    left, right = (rows[:, column + side - 20 : column + side] for side in (-reach, reach))
    return np.median(left, axis=(0, 1)), np.median(right, axis=(0, 1))


def show(page: Page, job: str, frame: int, shape: str) -> None:
    """Open a frame, seen from the front."""
    with page.expect_response(re.compile("/colors$")):
        page.goto(f"/jobs/{job}?frame={frame}&shape={shape}&quality=plain")
    expect_frame(page, frame, FRAMES)
    if shape == "surface":
        expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    page.locator(".scene").focus()
    page.keyboard.press("1")


@pytest.mark.parametrize("shape", ["points", "surface"])
def test_particles_and_surface_carry_the_colours_of_the_shapes(page, colored, shape):
    """Orange and blue are green and violet at the end; the look's own colour is a choice."""
    show(page, colored, 1, shape)
    (red, green, blue), (other_red, _, other_blue) = sides(page)
    assert red > green > blue and other_blue > other_red
    show(page, colored, FRAMES, shape)
    (red, green, blue), (other_red, other_green, other_blue) = sides(page)
    assert green > max(red, blue) and min(other_red, other_blue) > other_green
    colour = page.get_by_label("Colour", exact=True)
    expect(colour.locator("option:checked")).to_have_text("Of the shapes")
    before = picture(page)
    colour.select_option("look")
    changed(page, before)
    left, right = sides(page)
    assert np.abs(left - right).max() < 60  # light alone


def test_a_shape_without_colours_asks_for_none(page, service):
    """Of a job whose shapes have none, the look's colour is the only plain one."""
    job = service.submit(name="plain", frames=2, method="dco")
    service.wait_for(job, "succeeded", seconds=COMPILING)
    with page.expect_response(f"**/jobs/{job}/colors*") as asked:
        page.goto(f"/jobs/{job}?frame=2&shape=points&quality=plain")
    assert asked.value.headers["morph-shapes"] == "0"
    expect_frame(page, 2, 2)
    colour = page.get_by_label("Colour", exact=True)
    expect(colour.locator("option:checked")).to_have_text("Of the material")
    assert "Of the shapes" not in colour.inner_text()


@pytest.fixture(scope="module", params=[None, 256], ids=["corners", "textures"])
def moving(request, service, colored, tmp_path_factory) -> Path:
    """The same job as one mesh that moves, in a GLB file, with colours of either kind."""
    path = tmp_path_factory.mktemp("moving") / "moving.glb"
    result = service.data_dir / "jobs" / colored / "result.vtkhdf"
    return export(result, path, "glb", tracked=True, texture=request.param, fps=FPS)


def test_three_shows_the_colours_of_a_moving_mesh(moving, browser):
    """The Khronos validator finds nothing; orange and blue become green and violet."""
    issues = validated(moving)
    assert issues["messages"] == [] and issues["numErrors"] == 0
    with playing(browser, moving) as page:
        colors = []
        for frame in (0, FRAMES - 1):
            page.evaluate(f"shown({frame / FPS})")
            pixels = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), float)
            colors.append(pixels[100, [70, 130]])
    ((red, green, blue), (other_red, _, other_blue)), last = colors
    assert red > green > blue and other_blue > other_red
    (red, green, blue), (other_red, other_green, other_blue) = last
    assert green > max(red, blue) and min(other_red, other_blue) > other_green


def test_textures_are_a_choice_where_a_mesh_moves(page, colored, tmp_path):
    """As GLB, and as nothing else; the file has two pictures of the size that was chosen."""
    page.goto(f"/jobs/{colored}?quality=plain")
    details(page, "Files")
    page.get_by_label("Format").select_option("glb")
    page.get_by_label("Content").select_option("surface")
    choice = page.get_by_label("Colours", exact=True)
    expect(choice).to_be_hidden()
    page.get_by_label("Content").select_option("tracked")
    expect(choice).to_have_value("")
    choice.select_option("1024")
    page.get_by_role("button", name="Export").click()
    file = trimesh.load(saved(page, re.compile(r"^Save .*\.glb"), tmp_path))
    pictures = [part.visual.material.baseColorTexture for part in file.geometry.values()]
    assert [image.size for image in pictures] == [(1024, 1024)] * 2
