"""Jobs side by side: one camera, one time, one scale of colours, and who is better."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from PIL import Image, ImageChops, ImageOps
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser

SETTLED = 800
"""After this long [ms] a picture is drawn in full, also where drawing is slow."""

SAME = "shape=points&quality=plain"
"""Particles, drawn the same every time."""


@pytest.fixture(scope="module")
def jobs(service):
    """Two jobs that differ in their method and in their length."""
    made = [
        service.submit(name="by distance", method="dco", frames=4),
        service.submit(name="by density", method="dcd", frames=3),
    ]
    for job in made:
        service.wait_for(job, "succeeded", seconds=180)  # a first job compiles its kernels
    return made


@pytest.fixture
def compared(page, jobs) -> Page:
    """Both in sight, with the metrics beside them."""
    page.goto(f"/compare?jobs={','.join(jobs)}&details=metrics&{SAME}")
    expect_frames(page, "4 of 4", "3 of 3")
    return page


def expect_frames(page: Page, *frames: str) -> None:
    """Wait until the views show these frames."""
    for i, words in enumerate(frames):
        canvas = page.locator(".scene canvas").nth(i)
        expect(canvas).to_have_attribute("aria-label", re.compile(f"^Frame {words}, "))


def pictures(page: Page, border: int = 16) -> list[Image.Image]:
    """What the views show, without what floats over them and without their edges [pixels]."""
    page.wait_for_timeout(SETTLED)
    floating = page.locator(":is(.floating, .under)")
    floating.evaluate_all("all => all.forEach((one) => { one.style.visibility = 'hidden'; })")
    frames = page.locator(".scene-frame").all()
    shots = [Image.open(io.BytesIO(frame.screenshot())) for frame in frames]
    floating.evaluate_all("all => all.forEach((one) => { one.style.visibility = ''; })")
    return [ImageOps.crop(shot, border=border) for shot in shots]


def alike(one: Image.Image, other: Image.Image) -> bool:
    """Whether two pictures are the same but for the grain of the browser's gradients."""
    difference = ImageChops.difference(one.convert("RGB"), other.convert("RGB"))
    return max(high for _, high in difference.getextrema()) <= 2


def test_time_is_one(compared):
    """A step is a step in both; the shorter one waits at its end."""
    compared.get_by_role("slider", name="Frame").fill("1")
    expect_frames(compared, "2 of 4", "2 of 3")
    compared.get_by_role("slider", name="Frame").fill("3")
    expect_frames(compared, "4 of 4", "3 of 3")


def test_the_camera_is_one(page, jobs, service):
    """Who turns one view turns the other: two jobs that are alike look alike ever after."""
    twin = service.submit(name="twin", method="dco", frames=4)
    service.wait_for(twin, "succeeded", seconds=180)
    page.goto(f"/compare?jobs={jobs[0]},{twin}&{SAME}")
    expect_frames(page, "4 of 4", "4 of 4")
    before = pictures(page)
    assert alike(*before)
    page.locator(".scene").first.focus()
    for _ in range(6):
        page.keyboard.press("4")
    after = pictures(page)
    assert not alike(after[0], before[0])
    assert alike(*after)


@pytest.mark.usefixtures("queue_goes_on")
def test_a_job_that_has_not_begun_joins_later(service, jobs, page):
    """It has no picture at first; with its first frames it takes on camera and time."""
    service.pause_queue()
    waiting = service.submit(name="to come", method="dco", frames=4)
    page.goto(f"/compare?jobs={jobs[0]},{waiting}&{SAME}")
    expect_frames(page, "4 of 4")
    expect(page.locator(".scene canvas").nth(1)).to_have_attribute(
        "aria-label", "No frame is finished yet."
    )
    page.locator(".scene").first.focus()
    for _ in range(6):
        page.keyboard.press("4")
    service.unpause_queue()
    expect_frames(page, "4 of 4", "4 of 4")
    assert alike(*pictures(page))


def test_the_scale_of_colours_is_one(compared):
    """The same colour is the same value in both."""
    compared.keyboard.press("t")
    compared.get_by_label("Colour", exact=True).select_option("displacement")
    scales = compared.locator(".legend-ticks")
    expect(scales).to_have_count(2)
    expect(compared.locator(".legend-label").nth(1)).to_have_text("Displacement dx")
    compared.wait_for_timeout(SETTLED)
    assert scales.nth(0).inner_text() == scales.nth(1).inner_text()


def test_the_table_says_who_is_better(compared, jobs, service):
    """Differences to the first job are those of the metrics, with the right word."""
    ends = [service.job(job)["outcome"]["metrics"]["two_sided"] for job in jobs]
    row = compared.get_by_role("row").filter(has_text="Chamfer distance")
    expect(row.get_by_role("cell").nth(1)).to_contain_text(
        "better" if ends[1] < ends[0] else "worse"
    )
    expect(compared.locator(".charts .chart").first).to_contain_text("by density")


def test_a_job_is_compared_from_its_own_page(page, jobs):
    """The dialog of a job's page leads here."""
    page.goto(f"/jobs/{jobs[0]}?details=overview")
    page.get_by_role("button", name="Compare with…").click()
    page.get_by_role("dialog").get_by_label(re.compile("^by density")).check()
    page.get_by_role("dialog").get_by_role("button", name="Compare").click()
    expect(page.get_by_role("heading", name="Compare", exact=True)).to_be_visible()
    expect_frames(page, "4 of 4", "3 of 3")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious(jobs, new_page, serious_faults, scheme):
    """No serious finding of axe-core."""
    page = new_page(color_scheme=scheme)
    page.goto(f"/compare?jobs={','.join(jobs)}")
    expect_frames(page, "4 of 4", "3 of 3")
    assert serious_faults(page) == []


def test_a_phone_needs_no_sideways_scroll(jobs, new_page):
    """At 390 px the views lie under each other."""
    page = new_page(viewport={"width": 390, "height": 844}, has_touch=True)
    page.goto(f"/compare?jobs={','.join(jobs)}")
    expect_frames(page, "4 of 4", "3 of 3")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    tops = [view.bounding_box()["y"] for view in page.locator(".scene").all()]
    assert tops[1] > tops[0] + 250
    sizes = [canvas.bounding_box() for canvas in page.locator(".scene canvas").all()]
    assert sum(size["width"] * size["height"] for size in sizes) >= 0.6 * 390 * 844


@pytest.mark.parametrize("size", [(1400, 900), (390, 844)], ids=["desk", "phone"])
def test_nothing_floats_over_the_shapes(jobs, new_page, service, size):
    """Of four jobs all that is drawn is seen beside names and captions."""
    others = [service.submit(name=f"number {i}", method="dco", frames=2) for i in (3, 4)]
    for job in others:
        service.wait_for(job, "succeeded", seconds=180)
    page = new_page(viewport=dict(zip(("width", "height"), size, strict=True)))
    page.goto(f"/compare?jobs={','.join([*jobs, *others])}&{SAME}")
    expect_frames(page, "4 of 4", "3 of 3", "2 of 2", "2 of 2")
    floating = page.locator(":is(.compare-head, .under figcaption, .tools)").all()
    boxes = [box for one in floating if (box := one.bounding_box())]
    for at, view in enumerate(pictures(page, border=0)):
        rgb = np.asarray(view.convert("RGB"), int)
        shape = rgb[..., 0] - rgb[..., 2] > 20  # clay is redder than all around it
        assert shape.mean() > 0.05
        corner = page.locator(".scene-frame").nth(at).bounding_box()
        for box in boxes:
            left, above = int(box["x"] - corner["x"]), int(box["y"] - corner["y"])
            right, below = left + int(box["width"]), above + int(box["height"])
            under = shape[max(above, 0) : max(below, 0), max(left, 0) : max(right, 0)]
            assert not under.any(), f"{np.count_nonzero(under)} pixels are under {box}"


@pytest.mark.parametrize("count", [2, 3, 4])
def test_names_and_numbers_are_not_covered_or_cut(jobs, page, service, count):
    """Tools lie beside the names of all jobs, and a table that is wider than the drawer scrolls."""
    long = [service.submit(name=f"a job with a long name {i}", frames=1) for i in range(2)]
    page.goto(f"/compare?jobs={','.join([*jobs, *long][:count])}&details=metrics&{SAME}")
    expect(page.locator(".compare-head h2")).to_have_count(count)
    sheet = page.locator(".sheet:visible")
    expect(sheet.get_by_role("table")).to_be_visible()
    for width in (1400, 1000, 390):
        page.set_viewport_size({"width": width, "height": 900})
        tools = page.locator(".tools").bounding_box()
        for head in page.locator(".compare-head").all():
            box = head.bounding_box()
            beside = box["x"] + box["width"] <= tools["x"]
            assert beside or box["y"] >= tools["y"] + tools["height"]
        assert sheet.evaluate("one => one.scrollWidth <= one.clientWidth")
        table = page.locator(".differences")
        assert table.evaluate("one => one.offsetWidth <= one.parentElement.clientWidth")


def test_the_views_take_the_window(page, jobs):
    """Together at least 70 % of it, with nothing to scroll to."""
    page.goto(f"/compare?jobs={','.join(jobs)}")
    expect_frames(page, "4 of 4", "3 of 3")
    sizes = [canvas.bounding_box() for canvas in page.locator(".scene canvas").all()]
    assert sum(size["width"] * size["height"] for size in sizes) >= 0.7 * 1400 * 900
    assert page.evaluate("document.documentElement.scrollHeight") <= 900
