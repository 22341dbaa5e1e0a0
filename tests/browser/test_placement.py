"""Shapes turned, scaled and moved in the form, and landmarks picked on them."""

from __future__ import annotations

import io
import json
import re
from urllib.parse import urlencode

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import expect

from morph_engine.results.trajectory import Trajectory

pytestmark = pytest.mark.browser

AXES = ("x", "y", "z")

SETTLED = 800
"""After this long [ms] a small picture is drawn in full."""


def card(page, label):
    """The part of the form that chooses the source (`From`) or the target (`To`)."""
    return page.get_by_role("region", name=label, exact=True)


@pytest.fixture
def form(page, mesh_files):
    """A new morph of few particles and frames, from a sphere to a box that is an STL."""
    page.goto("/new")
    page.get_by_text("Research", exact=True).click()
    page.get_by_label("Particles per cell edge", exact=True).fill("1")
    page.get_by_label("Frames", exact=True).fill("3")
    page.get_by_label("Frames", exact=True).blur()
    card(page, "To").get_by_label("Mesh file of the target").set_input_files(mesh_files["box.stl"])
    expect(page.get_by_text("The target is rotated by 90 degrees about x")).to_be_visible()
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
    target.get_by_text("Rotate and move").click()
    expect(target.get_by_label("Upward axis")).to_contain_text("z, as usual for STL")
    target.get_by_label("Rotate about y, target").fill("30")
    target.get_by_label("Move along x, target").fill("-2.5")
    target.get_by_label("Size").fill("0.8")
    target.get_by_label("Size").press("ArrowUp")
    expect(target.get_by_text("rotated, scaled, moved")).to_be_visible()
    assert "placement.target.rotate" in form.url
    target.get_by_label("Size").fill("0")
    target.get_by_label("Size").blur()
    expect(target.get_by_role("alert").filter(has_text="above 0")).to_be_visible()
    form.reload()
    target.get_by_text("Rotate and move").click()
    expect(target.get_by_label("Rotate about y, target")).to_have_value("30")
    target.get_by_role("button", name="Reset").click()
    expect(target.get_by_label("Rotate about y, target")).to_have_value("0")
    assert "placement" not in form.url
    target.get_by_label("Rotate about z, target").fill("45")
    target.get_by_label("Rotate about z, target").blur()
    settle(form)
    _, config = config_of(service, form)
    usual = {"up": "auto", "rotate": [0, 0, 0], "scale": 1, "move": [0, 0, 0]}
    assert config["placement"] == {"source": usual, "target": usual | {"rotate": [0, 0, 45]}}


def test_built_in_shapes_are_turned_too(page):
    """The picture of the target is asked for as that of a target."""
    page.goto("/new")
    settle(page)
    target = card(page, "To")
    target.get_by_text("Rotate and move").click()
    with page.expect_request(re.compile("/shapes/star/particles.*rotate.*source=sphere")):
        target.get_by_label("Rotate about z, target").fill("90")
        target.get_by_label("Rotate about z, target").blur()
    settle(page)


def test_a_shape_that_lies_is_stood_up_with_a_click(page):
    """Where a file does not say which way is up, the form says so, and turns it by quarters."""
    page.goto("/new")
    egg = trimesh.creation.icosphere().apply_scale([1, 1, 2])
    file = {
        "name": "egg.obj",
        "mimeType": "model/obj",
        "buffer": egg.export(file_type="obj").encode(),
    }
    target = card(page, "To")
    target.get_by_label("Mesh file of the target").set_input_files(file)
    unknown = target.get_by_text("The file does not say which way is up.")
    expect(unknown).to_be_visible()
    settle(page)
    lying = width_of(page, "To")
    over = target.get_by_role("button", name="Tip it over")
    over.click()
    expect(unknown).to_be_hidden()
    expect(target.get_by_label("Rotate about x, target")).to_have_value("-90")
    settle(page)
    page.wait_for_timeout(SETTLED)
    assert width_of(page, "To") < 0.8 * lying
    for angle in ("180", "90", "0"):
        over.click()
        expect(target.get_by_label("Rotate about x, target")).to_have_value(angle)
    assert "placement" not in page.url
    expect(unknown).to_be_visible()


def width_of(page, label):
    """How wide the shape is in its picture [px]."""
    shot = Image.open(io.BytesIO(card(page, label).locator("canvas").screenshot())).convert("RGB")
    rgb = np.asarray(shot, int)
    return np.ptp(np.flatnonzero((rgb[..., 0] - rgb[..., 2] > 20).any(axis=0)))


def pull(page, label, start, by):
    """Draw what is so far from the middle of a picture by so much [px]."""
    x, y = middle(page, label)
    x, y = x + start[0], y + start[1]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + by[0], y + by[1], steps=5)
    page.mouse.up()


@pytest.mark.parametrize(("label", "role"), [("From", "source"), ("To", "target")])
def test_handles_move_scale_and_turn_by_as_much_as_they_are_drawn(
    service, page, mesh_files, label, role
):
    """A ball 12 wide is moved by what the pointer goes, scaled as far as it goes, and turned.

    Perspective shows a ball 4 % wider than its diameter; particles and pixels have the rest of 8.
    """
    settings = json.dumps({"sampling.points_per_cell_edge": 2, "frames": 2})
    page.goto(f"/new?{urlencode({'overrides': settings})}")
    for end in ("From", "To"):
        chooser = card(page, end).locator("input[type=file]")
        chooser.set_input_files(mesh_files["ball.obj"])
        expect(card(page, end).get_by_text("ball.obj: ")).to_be_visible()
    settle(page)
    ball = card(page, label)
    ball.get_by_text("Rotate and move").click()
    page.get_by_role("button", name="Morph", exact=True).hover()  # away from the handles
    ball.get_by_role("application").press("1")  # from the front
    expect(ball.get_by_role("application")).not_to_have_attribute("aria-busy", "true")
    page.wait_for_timeout(SETTLED)
    grid_units = 12 / width_of(page, label)

    def numbers(words):
        return [float(ball.get_by_label(f"{words} {axis}, {role}").input_value()) for axis in AXES]

    ball.get_by_role("button", name="Move", exact=True).click()
    page.wait_for_timeout(SETTLED)
    pull(page, label, (60, 4), (40, 0))
    expect(page).to_have_url(re.compile(rf"placement\.{role}\.move"))
    settle(page)
    assert numbers("Move along") == pytest.approx([40 * grid_units, 0, 0], rel=0.08, abs=0.01)
    assert numbers("Rotate about") == [0, 0, 0]
    ball.get_by_role("button", name="Reset").click()
    expect(page).not_to_have_url(re.compile("placement"))
    settle(page)

    ball.get_by_role("button", name="Scale", exact=True).click()
    page.wait_for_timeout(SETTLED)
    pull(page, label, (60, 4), (-15, 0))
    expect(page).to_have_url(re.compile(rf"placement\.{role}\.scale"))
    settle(page)
    scale = float(ball.get_by_label("Size").input_value())
    assert scale == pytest.approx(45 / 60, abs=0.03)
    assert numbers("Move along") == [0, 0, 0]

    ball.get_by_role("button", name="Rotate", exact=True).click()
    page.wait_for_timeout(SETTLED)
    pull(page, label, (65, -65), (-30, -30))
    expect(page).to_have_url(re.compile(rf"placement\.{role}\.rotate"))
    settle(page)
    turned = numbers("Rotate about")
    assert abs(turned[2]) > 5 and turned[:2] == pytest.approx([0, 0], abs=0.5)
    _, config = config_of(service, page)
    usual = {"up": "auto", "rotate": [0, 0, 0], "scale": 1, "move": [0, 0, 0]}
    placed = config["placement"]
    assert placed.pop(role) == usual | {"scale": scale, "rotate": turned}
    assert list(placed.values()) == [usual]


def test_what_is_turned_unasked_is_left_with_one_click(form):
    """The notice goes, and the upward axis is that of the other shape."""
    form.get_by_role("button", name="Keep both as they are").click()
    expect(form.get_by_text("is rotated by 90 degrees")).to_have_count(0)
    card(form, "To").get_by_text("Rotate and move").click()
    expect(card(form, "To").get_by_label("Upward axis")).to_have_value("y")


def test_removing_landmarks_keeps_the_focus(page):
    """On what is left, so that the keyboard goes on from there."""
    page.goto("/new")
    landmarks = page.get_by_role("region", name="Landmarks")
    typed = landmarks.get_by_role("button", name="Add by coordinates")
    for number in (1, 2):
        typed.click()
        expect(landmarks.get_by_role("listitem")).to_have_count(number)
    landmarks.get_by_role("button", name="Remove landmark 2").press("Enter")
    expect(landmarks.get_by_role("button", name="Remove landmark 1")).to_be_focused()
    landmarks.get_by_role("button", name="Remove landmark 1").press("Enter")
    expect(typed).to_be_focused()
    typed.click()
    landmarks.get_by_role("button", name="Undo").press("Enter")
    expect(landmarks.get_by_role("button", name="Pick in the views")).to_be_focused()


def test_landmarks_are_picked_named_and_kept(service, form, serious_faults):
    """A click on each shape makes a pair, in the file's own coordinates, which the job heeds.

    Undo takes back a click, then a pair. In the job's view the dot ends within 1 dx.
    """
    landmarks = form.get_by_role("region", name="Landmarks")
    landmarks.get_by_role("button", name="Pick in the views").click()
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
    landmarks.get_by_role("button", name="Pick in the views").click()
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
