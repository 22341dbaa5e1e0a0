"""Shapes turned, scaled and moved in the form, and landmarks picked on them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from playwright.sync_api import expect

from morph_engine.results.trajectory import Trajectory

pytestmark = pytest.mark.browser

AXES = ("x", "y", "z")


def card(page, label):
    """The part of the form that chooses the source (`From`) or the target (`To`)."""
    return page.get_by_role("region", name=label, exact=True)


@pytest.fixture
def form(page, mesh_files):
    """A new morph of few particles and frames, from a sphere to a box that is an STL."""
    page.goto("/new")
    page.get_by_label("Particles per cell edge", exact=True).fill("1")
    page.get_by_label("Frames", exact=True).fill("3")
    page.get_by_label("Frames", exact=True).blur()
    card(page, "To").get_by_label("Mesh file of the target").set_input_files(mesh_files["box.stl"])
    expect(page.get_by_text("The target is given a quarter turn about x")).to_be_visible()
    settle(page)
    return page


def settle(page):
    """Wait until the pictures show what was asked for."""
    for label in ("From", "To"):
        scene = card(page, label).get_by_role("application")
        expect(scene).not_to_have_attribute("aria-busy", "true")
        expect(card(page, label).get_by_role("status").first).to_contain_text("particles")
        expect(card(page, label).locator("canvas")).to_be_visible()


def middle(page, label):
    """The middle of the picture of a shape [px]."""
    canvas = card(page, label).locator("canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def config_of(service, page):
    """Submit the form, and what the service has made of it."""
    page.get_by_role("button", name="Morph", exact=True).click()
    page.wait_for_url("**/jobs/*")
    job = page.url.rpartition("/")[2]
    return job, service.call("GET", f"/v1/jobs/{job}/config").json()


def test_numbers_turn_scale_and_move(service, form):
    """They are kept in the address and with the job; one button takes all of it back."""
    target = card(form, "To")
    target.get_by_text("Turn and place").click()
    expect(target.get_by_label("Upward axis")).to_contain_text("z, as usual for STL")
    target.get_by_label("Turn about y, target").fill("30")
    target.get_by_label("Move along x, target").fill("-2.5")
    target.get_by_label("Size").fill("0.8")
    target.get_by_label("Size").press("ArrowUp")
    expect(target.get_by_text("turned, scaled, moved")).to_be_visible()
    assert "placement.target.rotate" in form.url
    target.get_by_label("Size").fill("0")
    target.get_by_label("Size").blur()
    expect(target.get_by_role("alert").filter(has_text="above 0")).to_be_visible()
    form.reload()
    target.get_by_text("Turn and place").click()
    expect(target.get_by_label("Turn about y, target")).to_have_value("30")
    target.get_by_role("button", name="Back to where it was").click()
    expect(target.get_by_label("Turn about y, target")).to_have_value("0")
    assert "placement" not in form.url
    target.get_by_label("Turn about z, target").fill("45")
    target.get_by_label("Turn about z, target").blur()
    settle(form)
    _, config = config_of(service, form)
    usual = {"up": "auto", "rotate": [0, 0, 0], "scale": 1, "move": [0, 0, 0]}
    assert config["placement"] == {"source": usual, "target": usual | {"rotate": [0, 0, 45]}}


def test_built_in_shapes_are_turned_too(page):
    """The picture of the target is asked for as that of a target."""
    page.goto("/new")
    settle(page)
    target = card(page, "To")
    target.get_by_text("Turn and place").click()
    with page.expect_request(re.compile("/shapes/star/particles.*rotate.*source=sphere")):
        target.get_by_label("Turn about z, target").fill("90")
        target.get_by_label("Turn about z, target").blur()
    settle(page)


def test_handles_in_the_picture_move_the_numbers(form):
    """A ring that is drawn turns the shape, and an arrow moves it; then the particles are new."""
    target = card(form, "To")
    target.get_by_text("Turn and place").click()
    for mode, label in (("Turn", "Turn about"), ("Move", "Move along")):
        target.get_by_role("button", name=mode, exact=True).click()
        numbers = [target.get_by_label(f"{label} {axis}, target") for axis in AXES]
        for reach in range(20, 150, 4):  # until a handle is under the pointer
            x, y = middle(form, "To")
            form.mouse.move(x + reach, y + (reach // 20))
            form.mouse.down()
            form.mouse.move(x + reach - 20, y - 40, steps=4)
            form.mouse.up()
            if any(float(number.input_value()) for number in numbers):
                break
        else:
            pytest.fail(f"no handle to {mode.lower()} by")
        settle(form)


def test_what_is_turned_unasked_is_left_with_one_click(form):
    """The notice goes, and the upward axis is that of the other shape."""
    form.get_by_role("button", name="Leave both as they lie").click()
    expect(form.get_by_text("is given a quarter turn")).to_have_count(0)
    card(form, "To").get_by_text("Turn and place").click()
    expect(card(form, "To").get_by_label("Upward axis")).to_have_value("y")


def test_landmarks_are_picked_named_and_kept(service, form, serious_faults):
    """A click on each shape makes a pair, in the file's own coordinates, which the job heeds.

    Undo takes back a click, then a pair. In the job's view the dot ends within 1 dx.
    """
    landmarks = form.get_by_role("region", name="Landmarks")
    landmarks.get_by_role("button", name="Pick in the pictures").click()
    rows = landmarks.get_by_role("listitem")
    form.mouse.click(*middle(form, "From"))
    expect(landmarks.get_by_role("status")).to_have_text(re.compile("Now click .* target"))
    landmarks.get_by_role("button", name="Undo").click()
    expect(landmarks.get_by_role("status")).to_have_text(re.compile("^Click a point of the source"))
    for _ in range(2):
        form.mouse.click(*middle(form, "From"))
        form.mouse.click(*middle(form, "To"))
    expect(rows).to_have_count(2)
    landmarks.get_by_role("button", name="Undo").click()
    expect(rows).to_have_count(1)
    landmarks.get_by_label("Name").fill("front")
    landmarks.get_by_label("Name").blur()
    landmarks.get_by_role("button", name="Pick in the pictures").click()
    assert serious_faults(form) == []
    form.get_by_label("Particles per cell edge", exact=True).fill("2")
    form.get_by_label("Frames", exact=True).fill("10")
    form.get_by_label("Frames", exact=True).blur()
    settle(form)
    job, config = config_of(service, form)
    (mark,) = config["method"]["landmarks"]
    assert mark["name"] == "front"
    assert max(abs(x) for x in mark["target"]) == pytest.approx(4.5, abs=0.6)  # on the 9 dx box
    assert service.wait_for(job, "succeeded", "failed", seconds=500)["state"] == "succeeded"
    form.goto(f"/jobs/{job}?frame=10")
    form.get_by_role("button", name="Details", exact=True).click()
    listed = form.get_by_role("region", name="Landmarks").get_by_role("listitem")
    expect(listed).to_contain_text("front")
    with Trajectory(service.data_dir / "jobs" / job / "result.vtkhdf") as result:
        run = result.run
        start, end = (
            getattr(run.placement, role).apply(mark[role]) for role in ("source", "target")
        )
        particle = np.linalg.norm(run.source_points - start, axis=1).argmin()
        away = float(np.linalg.norm(result.positions(-1)[particle] - end))
    assert away < 1
    expect(listed).to_contain_text(f"{away:.2f}"[:3])
