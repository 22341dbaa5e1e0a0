"""The page of a job: seen in 3D, in curves and in words, from its first frame to its files."""

from __future__ import annotations

import csv
import io
import re
import time
import zipfile
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh
from PIL import Image, ImageChops, ImageStat
from playwright.sync_api import Page, expect

from tests.patience import patient, until

pytestmark = pytest.mark.browser

FRAMES = 4
HURRIED = 40
"""Frames of a job that has too little time."""

MANY = 2000
"""Frames of a job that lasts until it is cancelled."""

COMPILING = 180
"""A first job compiles its kernels for as long [s] on a busy machine."""

PATIENCE = 180
"""How long a picture may take to change [s]."""

SETTLED = 500
"""A picture that has not changed for as long [ms] is at rest."""

BEGINNING = "The source. No frame is finished yet."

ASKED_FOR_FULL_SCREEN = """() => {
  window.answer = new Promise((resolve) => {
    const unasked = setTimeout(() => resolve("not asked"), 20_000);
    const request = Element.prototype.requestFullscreen;
    Element.prototype.requestFullscreen = function (...options) {
      clearTimeout(unasked);
      setTimeout(() => resolve("no answer"), 15_000);
      document.addEventListener("fullscreenerror", () => resolve("refused"), { once: true });
      const changed = () =>
        setTimeout(() => resolve(document.fullscreenElement ? "granted" : "taken back"), 1000);
      document.addEventListener("fullscreenchange", changed, { once: true });
      return request.apply(this, options);
    };
  });
}"""
"""What the browser answers to a page that asks for the full screen."""


@pytest.fixture(scope="module")
def done(service):
    """A job of a few frames that is done."""
    job = service.submit(name="a job to look at", frames=FRAMES, method="dco")
    service.wait_for(job, "succeeded", seconds=COMPILING)
    return job


@pytest.fixture(scope="module")
def failed(service):
    """A job whose particles would have to be faster than they may be."""
    settings = {"sampling.points_per_cell_edge": 1, "watchdog.cells_per_step": 0.02}
    job = service.submit(frames=HURRIED, method="transport", overrides=settings)
    service.wait_for(job, "failed", seconds=COMPILING)
    return job


@pytest.fixture
def opened(page, done) -> Page:
    """Its page, with the particles of the last frame in sight, drawn the same every time."""
    with page.expect_response(re.compile("/config$")):  # which says how large particles are
        page.goto(f"/jobs/{done}?frame={FRAMES}&shape=points&quality=plain")
    expect_frame(page, FRAMES)
    return page


def details(page: Page, title: str) -> None:
    """Open a sheet of the drawer."""
    if not page.locator(".drawer").is_visible():
        page.get_by_role("button", name="Details", exact=True).click()
    page.get_by_role("tab", name=title).click()


def expect_frame(page: Page, number: int, of: int = FRAMES) -> None:
    """Wait until a frame is to be seen, and said in words."""
    canvas = page.locator(".scene canvas").first
    words = rf"^Frame {number} of {of}, Chamfer distance \d.* dx, coverage \d+\s%\.$"
    expect(canvas).to_have_attribute("aria-label", re.compile(words))


def picture(page: Page, which: int = 0) -> Image.Image:
    """What a 3D view shows once it is at rest, without what floats over it."""
    frame = page.locator(".scene-frame").nth(which)
    frame.evaluate("frame => { frame.style.zIndex = 9; }")
    deadline = time.monotonic() + PATIENCE
    before = None
    while True:
        page.wait_for_timeout(SETTLED)
        expect(frame.locator("canvas")).not_to_have_attribute("aria-busy", "true")
        shot = Image.open(io.BytesIO(frame.screenshot())).convert("RGB")
        if shot == before:
            break
        assert time.monotonic() < deadline, "The picture changes on and on."
        before = shot
    frame.evaluate("frame => { frame.style.zIndex = ''; }")
    return shot


def changed(page: Page, before: Image.Image) -> Image.Image:
    """Wait until a 3D view shows something else, and return it."""
    deadline = time.monotonic() + PATIENCE
    while (now := picture(page)) == before:
        assert time.monotonic() < deadline, "The picture stays the same."
    return now


def top(page: Page) -> float:
    """Where the scale of colours ends."""
    return float(page.locator(".legend-ticks").inner_text().split()[-1])


def drawn(page: Page) -> float:
    """Share of a 3D view that is not background."""
    full = picture(page)
    canvas = page.locator(".scene canvas").first
    canvas.evaluate("canvas => { canvas.style.opacity = 0; }")
    empty = picture(page)
    canvas.evaluate("canvas => { canvas.style.opacity = ''; }")
    changed = ImageChops.difference(full, empty).convert("L").point(lambda v: 255 * (v > 8))
    return sum(changed.histogram()[255:]) / (full.width * full.height)


def saved(page: Page, label: str | re.Pattern[str], folder: Path) -> Path:
    """What a button lets the browser save."""
    with page.expect_download() as download:
        page.get_by_role("button", name=label).click()
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    return path


def test_a_download_that_breaks_off_is_told_of(opened):
    """The service may stop when the answer has begun; the browser then fails its body."""
    cut = "Promise.reject(new TypeError('cut'))"
    opened.evaluate(f"() => {{ Response.prototype.blob = () => {cut}; }}")
    details(opened, "Files")
    opened.get_by_role("button", name="Metrics, CSV").click()
    expect(opened.get_by_text("The service does not answer.")).to_be_visible()


@pytest.mark.usefixtures("queue_goes_on")
def test_a_remembered_target_comes_with_the_first_frame(service, page):
    """On a page that was opened before the job began, too."""
    page.goto("/")
    shown = {"colour": "height", "target": "cloud"}
    page.evaluate("shown => localStorage.setItem('morph-display', JSON.stringify(shown))", shown)
    service.pause_queue()
    job = service.submit(name="waiting", frames=FRAMES, method="dco")
    with page.expect_response(re.compile("/target")) as refused:
        page.goto(f"/jobs/{job}")
    assert refused.value.status == 404
    expect(page.locator(".scene canvas")).to_have_attribute("aria-label", BEGINNING)
    with page.expect_response(re.compile("/target"), timeout=COMPILING * 1000) as found:
        service.unpause_queue()
    assert found.value.ok


@pytest.mark.usefixtures("queue_goes_on")
def test_the_source_is_in_sight_before_the_first_frame(service, page):
    """While the job waits, while its method gets ready, and while that frame is on its way."""
    service.pause_queue()
    job = service.submit(name="large", frames=1, method="flow", overrides={})
    page.route(re.compile(f"/jobs/{job}/frames/"), lambda _: None)  # its frame is on its way
    page.goto(f"/jobs/{job}?quality=sketch")  # or a busy machine may draw less of it later
    expect(page.locator(".scene canvas")).to_have_attribute("aria-label", BEGINNING)
    expect(page.locator(".summary")).to_contain_text("Queued")
    waiting = picture(page)
    assert drawn(page) > 0.05
    with page.expect_response(re.compile("/source"), timeout=COMPILING * 1000):
        service.unpause_queue()
    expect(page.locator(".scene canvas")).to_have_attribute("aria-label", BEGINNING)
    assert ImageStat.Stat(ImageChops.difference(picture(page), waiting)).mean[0] < 1
    service.wait_for(job, "succeeded", seconds=COMPILING)  # only the frame is missing
    expect(page.locator(".summary")).to_contain_text("Succeeded")
    assert ImageStat.Stat(ImageChops.difference(picture(page), waiting)).mean[0] < 1


@pytest.mark.usefixtures("queue_goes_on")
def test_a_retry_begins_with_the_source(service, page):
    """While the job waits again, nothing of its first time is in sight."""
    job = service.submit(name="twice", frames=FRAMES, method="dco")
    service.wait_for(job, "succeeded", seconds=COMPILING)
    page.goto(f"/jobs/{job}?details=overview")
    expect_frame(page, 1)
    assert drawn(page) > 0.05
    service.pause_queue()
    page.get_by_role("button", name="Retry").click()
    with page.expect_response(re.compile("/shapes/sphere/particles")):
        page.get_by_role("dialog").get_by_role("button", name="Retry").click()
    expect(page.locator(".scene canvas")).to_have_attribute("aria-label", BEGINNING)
    expect(page.locator(".timeline output")).to_have_text("–")
    assert drawn(page) > 0.05
    service.unpause_queue()
    expect_frame(page, FRAMES)
    assert drawn(page) > 0.05


@pytest.mark.usefixtures("queue_goes_on")
def test_a_job_is_watched_to_its_end(service, page):
    """Frames, curves and state arrive by themselves, and the newest frame is in sight."""
    service.pause_queue()
    job = service.submit(name="watched", frames=FRAMES, method="dco")
    page.goto(f"/jobs/{job}?details=curves")
    expect(page.locator(".summary")).to_contain_text("Queued")
    service.unpause_queue()
    service.wait_for(job, "succeeded", seconds=COMPILING)
    expect(page.locator(".summary")).to_contain_text("Succeeded")
    expect_frame(page, FRAMES)
    expect(page.locator(".timeline output")).to_have_text(f"{FRAMES} / {FRAMES}")
    expect(
        page.get_by_role("img", name=re.compile("^Chamfer distance over frames"))
    ).to_be_visible()
    expect(page.locator(".history")).to_contain_text("Attempt 1 started.")
    assert 0.05 < drawn(page) < 0.95


@pytest.mark.parametrize("size", [(1400, 900), (390, 844)], ids=["desk", "phone"])
def test_a_job_that_fails_says_so_and_keeps_its_frames(failed, new_page, size):
    """With what was wrong and what to do, beside the last frame; the drawer covers none of it."""
    width, height = size
    page = new_page(viewport={"width": width, "height": height})
    page.goto(f"/jobs/{failed}?shape=points&quality=plain")
    headline = page.locator(".headline")
    found = re.compile(r"cannot continue after (\d+) frames?: a particle moves faster")
    expect(headline).to_contain_text(found)
    expect(headline).to_contain_text(
        "Finished frames are kept; try more “Frames”, or “Transitions per frame” under “Time”"
    )
    finished = int(found.search(headline.text_content())[1])
    expect(headline).to_contain_text(f"{finished} of {HURRIED} frames")
    expect_frame(page, 1, of=HURRIED)
    page.keyboard.press("n")
    drawer = page.locator(".drawer")
    expect(drawer.get_by_role("button", name="Resume")).to_be_visible()
    expect(drawer).to_contain_text(found)  # as the last of what happened
    timeline, tabs = page.locator(".timeline").bounding_box(), drawer.bounding_box()
    assert timeline["x"] + timeline["width"] <= tabs["x"] or (
        timeline["y"] + timeline["height"] <= tabs["y"]
    )


def test_the_timeline_scrubs_steps_and_plays(opened):
    """Another frame is another picture; playing ends at the last one."""
    opened.get_by_label("Drawing", exact=True).select_option("plain")  # however busy the machine
    last = picture(opened)
    opened.get_by_role("slider", name="Frame").fill("0")
    expect_frame(opened, 1)
    changed(opened, last)
    opened.get_by_role("button", name="Next frame").click()
    expect_frame(opened, 2)
    opened.get_by_role("button", name="Play", exact=True).click()
    expect_frame(opened, FRAMES)
    expect(opened.get_by_role("button", name="Play", exact=True)).to_be_visible()
    assert picture(opened) == last


LATER_FRAMES = """reading => {
  const frames = [];
  const add = () => frames.push(parseInt(reading.textContent));
  new MutationObserver(add).observe(reading, { childList: true });
  return frames;
}"""
"""A list to which the number of each frame is added that the timeline goes to."""


def test_playing_skips_nothing_where_the_page_stood_still(opened):
    """A page that is kept busy for longer than the whole job lasts shows every frame of it."""
    opened.get_by_label("Speed", exact=True).select_option("4")
    later = opened.locator(".timeline .reading").evaluate_handle(LATER_FRAMES)
    opened.evaluate(
        """frames => {
          let left = frames + 2;
          const keepBusy = () => {
            const end = performance.now() + 1000;
            while (performance.now() < end);
            if (--left) requestAnimationFrame(keepBusy);
          };
          document.querySelector(".timeline .primary").click();
          requestAnimationFrame(keepBusy);
        }""",
        FRAMES,
    )
    expect(opened.get_by_role("button", name="Play", exact=True)).to_be_visible()
    assert set(later.json_value()) == {*range(1, FRAMES + 1)}


def test_a_job_is_played_in_a_time_of_its_own(opened):
    """Slowly at both shapes, there and back; then frame by frame again."""
    speed, reading = opened.get_by_label("Speed", exact=True), opened.locator(".timeline .reading")
    with opened.expect_response(re.compile("/playback")) as answer:
        opened.get_by_label("Pace", exact=True).select_option("in-out")
    assert len(answer.value.json()["frames"]) == 5 * 30
    lasts = opened.get_by_label("Duration")
    with opened.expect_response(re.compile("seconds=2.5&")) as answer:
        lasts.fill("2.5")
        lasts.blur()
    with opened.expect_response(re.compile("fps=24")) as answer:
        opened.get_by_label("Frame rate").select_option("24")
    assert len(answer.value.json()["frames"]) == 60
    lasts.fill("0")
    lasts.blur()
    expect(opened.get_by_text("Enter a number of seconds from 0.1 to 3600.")).to_be_visible()
    lasts.fill("10")
    lasts.blur()
    with opened.expect_response(re.compile("repeat=ping-pong")):
        opened.get_by_label("Repeat", exact=True).select_option("ping-pong")
    expect(speed).to_be_hidden()
    expect(opened.get_by_label("Loop")).to_be_checked()
    opened.get_by_label("Loop").uncheck()
    later = reading.evaluate_handle(LATER_FRAMES)
    opened.get_by_role("button", name="Play", exact=True).click()
    expect(reading).to_have_text(f"1 / {FRAMES}")
    expect(opened.get_by_role("button", name="Play", exact=True)).to_be_visible()
    frames = later.json_value()
    frames = frames[frames.index(1) :]
    farthest = frames.index(max(frames))
    assert frames[farthest] >= FRAMES - 1  # the target itself is but an instant
    assert frames[: farthest + 1] == sorted(frames[: farthest + 1])
    assert frames[farthest:] == sorted(frames[farthest:], reverse=True)
    assert frames[-1] == 1
    opened.get_by_label("Pace", exact=True).select_option("frames")
    expect(speed).to_be_visible()


def test_a_cut_hides_half_of_it(opened):
    """The cutting plane takes away what lies beyond it; nothing is left beyond everything."""
    whole = drawn(opened)
    opened.get_by_label("Cut", exact=True).select_option("x")
    half = drawn(opened)
    assert 0.3 * whole < half < 0.9 * whole
    opened.get_by_label("Position of the cut").fill("-14")
    expect(opened.locator(".cut-reading")).to_have_text("x = -14.0 dx")
    assert drawn(opened) < 0.01


@pytest.mark.parametrize(
    ("colour", "legend"),
    [("displacement", "Displacement dx"), ("density", "Density relative to target ratio")],
)
def test_colours_come_with_a_scale(opened, colour, legend):
    """Values of the page's own and of the service colour the particles, with name and unit."""
    opened.get_by_label("Colour", exact=True).select_option("own")
    plain = picture(opened)
    expect(opened.locator(".legend")).to_be_hidden()
    opened.get_by_label("Colour", exact=True).select_option(colour)
    expect(opened.locator(".legend-label")).to_have_text(legend)
    expect(opened.locator(".legend-ticks span")).to_have_count(5)
    changed(opened, plain)


@pytest.mark.usefixtures("queue_goes_on")
def test_the_scale_of_colours_grows_with_a_run(service, new_page):
    """Who watches from the first frame on ends with the same scale as who comes later."""
    page, late = new_page(), new_page()
    page.goto("/")
    page.evaluate("localStorage.setItem('morph-display', JSON.stringify({colour: 'displacement'}))")
    service.pause_queue()
    job = service.submit(name="far", frames=40)
    page.goto(f"/jobs/{job}")
    expect(page.locator(".scene canvas")).to_have_attribute("aria-label", BEGINNING)
    service.unpause_queue()
    service.wait_for(job, "succeeded", seconds=COMPILING)
    late.goto(f"/jobs/{job}")
    late.get_by_label("Colour", exact=True).select_option("displacement")
    for view in (page, late):
        expect(view.locator(".legend-ticks")).to_be_visible()
    deadline = time.monotonic() + PATIENCE
    while top(page) != top(late):
        assert time.monotonic() < deadline, f"One ends at {top(page)}, one at {top(late)}."
        page.wait_for_timeout(SETTLED)


def test_a_surface_is_what_one_sees_first(page, done):
    """Particles are a key away; the overview says how far the surface is from the target."""
    page.goto(f"/jobs/{done}?quality=plain&details=overview")
    expect_frame(page, 1)
    words = page.locator(".overview .surface-words")
    expect(words).to_contain_text(re.compile(r"surface, \d\.\d+ dx from"))
    expect(words).to_be_visible()
    expect(page.locator(".under figcaption")).to_have_text(f"Frame 1 of {FRAMES}")
    expect(page.locator(".under")).not_to_contain_text(re.compile(r"\bdx\b|%"))
    page.get_by_role("button", name="Details", exact=True).click()
    surface = picture(page)
    page.keyboard.press("p")
    expect(page.get_by_label("Show as")).to_have_value("points")
    changed(page, surface)
    expect(words).to_be_empty()
    page.keyboard.press("s")
    expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    without = picture(page)
    assert without == surface
    page.get_by_label("Target").select_option("wireframe")
    changed(page, without)


def test_the_ends_are_ones_own_meshes_if_one_wants_it(page, done):
    """The surface of the last frame is snapped to the target, and is as computed again."""
    page.goto(f"/jobs/{done}?frame={FRAMES}&quality=plain")
    expect_frame(page, FRAMES)
    expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    computed, ends = picture(page), page.get_by_label("Ends", exact=True)
    ends.select_option("meshes")
    page.wait_for_url(re.compile("ends=meshes"))
    snapped = changed(page, computed)
    ends.select_option("matter")
    assert changed(page, snapped) == computed
    page.keyboard.press("p")
    expect(ends).to_be_hidden()


def test_a_cut_surface_is_closed(page, done):
    """Where the plane cuts it there is one flat face, lit the same all over."""
    page.goto(f"/jobs/{done}?frame={FRAMES}&quality=plain")
    expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    page.keyboard.press("1")  # from the front, along z
    whole = picture(page)
    page.get_by_label("Cut", exact=True).select_option("z")
    cut = changed(page, whole)
    x, y = cut.width // 2, cut.height // 2
    face = cut.crop((x - 30, y - 30, x + 30, y + 30))
    assert max(ImageStat.Stat(face).stddev) < 4
    assert drawn(page) > 0.05


def test_the_shadow_of_what_is_cut_is_a_part_of_the_whole_one(page, done):
    """What a cut takes away casts none, and nothing gets darker by it."""
    page.goto(f"/jobs/{done}?frame={FRAMES}&quality=plain")
    expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    whole = np.asarray(picture(page), int)
    page.get_by_label("Cut", exact=True).select_option("z")
    cut = np.asarray(picture(page), int)
    shape = whole[..., 0] - whole[..., 2] > 20  # clay is redder than all around it
    around = (whole - cut).mean(axis=2)[~shape]
    assert np.count_nonzero(around < -8) > 0.01 * shape.sum()
    assert np.count_nonzero(around > 8) < 0.002 * shape.sum()


@pytest.mark.parametrize("shape", ["points", "surface"])
def test_a_frame_looks_the_same_whatever_was_seen_before(page, done, shape):
    """Its size, and the ground below it: each end before and after the other one."""
    for first, other in ((1, FRAMES), (FRAMES, 1)):
        page.goto(f"/jobs/{done}?frame={first}&shape={shape}&quality=plain")
        before = shown(page, first, shape)
        page.keyboard.press("Shift+ArrowLeft" if other == 1 else "Shift+ArrowRight")
        assert shown(page, other, shape) != before
        page.keyboard.press("Shift+ArrowLeft" if first == 1 else "Shift+ArrowRight")
        assert shown(page, first, shape) == before


def shown(page: Page, number: int, shape: str) -> Image.Image:
    """What the page shows of a frame, with its surface if that is wanted."""
    expect_frame(page, number)
    if shape == "surface":
        expect(page.locator(".surface-words")).to_contain_text(f"Frame {number}: closed surface")
    return picture(page)


def test_looks_are_in_the_address(page, done):
    """Each material is another picture; a reload shows the same one."""
    page.goto(f"/jobs/{done}?quality=full")
    expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    names = ["clay", "porcelain", "jelly", "metal", "wax", "glass"]
    assert (
        page.get_by_label("Look", exact=True)
        .locator("option")
        .evaluate_all("options => options.map((one) => one.value)")
        == names
    )
    seen = [picture(page)]
    for name in names[1:]:
        page.get_by_label("Look", exact=True).select_option(name)
        seen.append(changed(page, seen[-1]))
        page.wait_for_url(re.compile(f"look={name}"))
    assert all(one != other for i, one in enumerate(seen) for other in seen[:i])
    page.reload()
    expect(page.get_by_label("Look", exact=True)).to_have_value("glass")


def test_creases_and_the_ground_below_are_darker(service, page):
    """Ambient occlusion darkens what is hollow, the soft shadow the ground around it."""
    job = service.submit(name="hollow", target={"shape": "torus"}, frames=2, method="dco")
    service.wait_for(job, "succeeded", seconds=COMPILING)
    seen = {}
    for fineness in ("plain", "full"):
        page.goto(f"/jobs/{job}?frame=2&quality={fineness}")
        expect(page.locator(".surface-words")).to_contain_text("dx from the target")
        seen[fineness] = np.asarray(picture(page), int)
    page.locator(".scene canvas").evaluate("canvas => { canvas.style.opacity = 0; }")
    empty = np.asarray(picture(page), int)
    plain, full = seen["plain"], seen["full"]
    shape = plain[..., 0] - plain[..., 2] > 20  # clay is redder than all around it
    creases = (plain - full).mean(axis=2)[shape]
    assert np.mean(creases > 8) > 0.001
    assert np.mean(creases < -8) < 0.0001
    shadow = ((empty - full).mean(axis=2) > 8) & ~shape
    assert shadow.sum() > 0.05 * shape.sum()
    middles = [np.nonzero(one)[0].mean() for one in (shape, shadow)]
    assert middles[0] < middles[1]  # the shadow lies lower


@pytest.mark.parametrize("look", ["clay", "jelly", "metal"])
def test_a_sketch_of_a_surface_is_lit_like_a_finer_picture(page, done, look):
    """Which takes its light from a picture of a ball: within 12 levels of 255 on the average."""
    seen = []
    for fineness in ("sketch", "plain"):
        page.goto(f"/jobs/{done}?frame={FRAMES}&look={look}&quality={fineness}")
        expect(page.locator(".surface-words")).to_contain_text("dx from the target")
        taken = picture(page)
        width, height = taken.size
        seen.append(taken.crop((width // 4, height // 4, 3 * width // 4, 3 * height // 4)))
    coarse, fine = (one.resize((40, 40), Image.Resampling.BOX) for one in seen)
    assert sum(ImageStat.Stat(ImageChops.difference(coarse, fine)).mean) / 3 < 12
    assert max(ImageStat.Stat(fine).stddev) > 8  # there is light and shade to be compared


def test_what_is_nearer_or_farther_is_blurred_if_one_wants_it(opened):
    """Depth of field is off at first, in the address, and takes nothing of the light."""
    sharp = picture(opened)
    opened.get_by_label("Focus").select_option("Shallow")
    expect(opened).to_have_url(re.compile("focus=shallow"))
    shallow = changed(opened, sharp)

    def edges(shot):
        return np.abs(np.diff(np.asarray(shot.convert("L"), float), axis=1)).mean()

    assert edges(shallow) < 0.8 * edges(sharp)
    assert ImageStat.Stat(shallow).mean == pytest.approx(ImageStat.Stat(sharp).mean, abs=1.5)
    opened.get_by_label("Focus").select_option("Sharp")
    until(lambda: edges(picture(opened)) > 0.95 * edges(sharp), "What was blurred stays so.")


def test_the_page_says_how_finely_it_draws(page, done):
    """By what pictures take, unless somebody chooses."""
    page.goto(f"/jobs/{done}?shape=points")
    reading = page.locator(".drawn-reading")
    expect(reading).to_have_text(re.compile(r"^Drawing: (full|plain|sketch)"))
    page.get_by_label("Drawing").select_option("sketch")
    expect(reading).to_have_text("Drawing: sketch")
    page.wait_for_url(re.compile("quality=sketch"))


@pytest.mark.parametrize("shape", ["points", "surface"])
def test_what_moves_is_seen_between_frames(opened, shape):
    """While one frame is told, the matter is in several places on its way to the next."""
    opened.get_by_label("Show as").select_option(shape)
    opened.get_by_label("Drawing").select_option("sketch")
    opened.get_by_role("combobox", name="Speed").select_option("4")
    opened.get_by_label("Loop").check()
    opened.get_by_role("button", name="Play", exact=True).click()
    if shape == "surface":  # in motion once all are there
        expect(opened.locator(".scene-note")).to_contain_text("Particles until")
        expect(opened.locator(".surface-words")).to_contain_text("dx from the target")
    pictures = opened.evaluate(
        """async () => {
          const canvas = document.querySelector(".scene canvas");
          const reading = document.querySelector(".timeline output");
          const small = Object.assign(document.createElement("canvas"), { width: 96, height: 96 });
          const context = small.getContext("2d", { willReadFrequently: true });
          const seen = {};
          const end = performance.now() + 1500;
          while (performance.now() < end) {
            await new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)));
            context.clearRect(0, 0, 96, 96);
            context.drawImage(canvas, 0, 0, 96, 96);
            const { data } = context.getImageData(0, 0, 96, 96);
            const told = (seen[reading.textContent] ??= []);
            if (data.some((level) => level > 0)) told.push(data.join());
          }
          return Object.entries(seen).map(([frame, all]) => [frame, new Set(all).size]);
        }"""
    )
    assert max(count for _, count in pictures) > 1, pictures
    opened.get_by_role("button", name="Pause").click()
    expect(opened.get_by_role("button", name="Play", exact=True)).to_be_visible()


NAMELESS = """all => all
  .filter((one) => !one.title && (one.matches("select") || !one.textContent))
  .map((one) => one.outerHTML)"""
"""Of some controls those that say nothing on hovering; what a list offers is not its name."""


@pytest.mark.parametrize(
    ("size", "share"), [((1400, 900), 0.7), ((390, 844), 0.6)], ids=["desk", "phone"]
)
def test_the_view_takes_the_window(done, new_page, size, share):
    """Nothing is cut or has to be scrolled to, and each control says its name on hovering."""
    width, height = size
    page = new_page(viewport={"width": width, "height": height})
    page.goto(f"/jobs/{done}")
    expect_frame(page, 1)
    box = page.locator(".scene canvas").bounding_box()
    assert box["width"] * box["height"] >= share * width * height
    if not page.locator(".display").is_visible():
        page.keyboard.press("t")
    controls = page.locator(".tools button, .display select, .timeline :is(button, input, select)")
    for control in [one for one in controls.all() if one.is_visible()]:
        place = control.bounding_box()
        assert place["x"] >= 0 and place["x"] + place["width"] <= width, control
        assert place["y"] >= 0 and place["y"] + place["height"] <= height, control
    nameless = page.locator(".tools button, .display select, .timeline :is(button, select)")
    assert nameless.evaluate_all(NAMELESS) == []
    page.keyboard.press("t")
    page.keyboard.press("n")
    expect(page.locator(".drawer")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollHeight") <= height
    open_box = page.locator(".scene canvas").bounding_box()
    assert open_box["x"] + open_box["width"] <= page.locator(".drawer").bounding_box()["x"] or (
        open_box["y"] + open_box["height"] <= page.locator(".drawer").bounding_box()["y"] + 1
    )


@pytest.mark.parametrize("size", [(1400, 900), (390, 844)], ids=["desk", "phone"])
@pytest.mark.parametrize("opened", ["t", "n"], ids=["display", "details"])
def test_nothing_floats_over_the_shape(done, new_page, size, opened):
    """All of it is seen beside headline, tools, display and timeline, whatever is open."""
    width, height = size
    page = new_page(viewport={"width": width, "height": height})
    page.goto(f"/jobs/{done}?frame={FRAMES}&shape=points&quality=plain")
    expect_frame(page, FRAMES)
    if not page.locator({"t": ".display", "n": ".drawer"}[opened]).is_visible():
        page.keyboard.press(opened)
    corner = page.locator(".scene-frame").bounding_box()
    rgb = np.asarray(picture(page), int)
    shape = rgb[..., 0] - rgb[..., 2] > 20  # clay is redder than all around it
    assert shape.sum() > 0.02 * width * height
    for name in (".headline", ".tools", ".display", ".timeline"):
        if not (box := page.locator(name).bounding_box()):
            continue
        left, above = int(box["x"] - corner["x"]), int(box["y"] - corner["y"])
        under = shape[above:, left:][: int(box["height"]), : int(box["width"])]
        assert not under.any(), f"{np.count_nonzero(under)} pixels are under {name}"


def test_the_drawer_is_in_the_address(opened):
    """Each sheet by its tab; a reload opens the same one."""
    details(opened, "Settings")
    opened.wait_for_url(re.compile("details=settings"))
    opened.reload()
    expect(opened.get_by_role("heading", name="Settings")).to_be_visible()
    opened.get_by_role("tab", name="Settings").focus()
    opened.keyboard.press("ArrowRight")
    expect(opened.get_by_role("heading", name="Downloads")).to_be_visible()
    opened.keyboard.press("Escape")
    expect(opened.locator(".drawer")).to_be_hidden()
    expect(opened.get_by_role("button", name="Details", exact=True)).to_be_focused()


CUT = """() => {
  const context = document.createElement("canvas").getContext("2d");
  const seen = (one) => one.offsetParent !== null;
  const lists = [...document.querySelectorAll(".stage-window select")].filter(seen);
  const cut = lists.filter((select) => {
    const { font, paddingLeft, paddingRight } = getComputedStyle(select);
    context.font = font;
    const { width } = context.measureText(select.selectedOptions[0].textContent);
    const arrow = 20;
    return width + arrow + parseFloat(paddingLeft) + parseFloat(paddingRight) > select.clientWidth;
  });
  const wide = [...document.querySelectorAll(".drawer *, .display *")].filter(seen);
  return [
    ...cut.map((select) => select.selectedOptions[0].textContent),
    ...wide.filter((one) => one.matches(".table-scroll, .sheet, .display"))
      .filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.className),
  ];
}"""
"""What is chosen in lists, and tables, that do not fit."""


def with_display(new_page, job, size):
    """The page of a job in a window of some size, with what there is to set about its look."""
    page = new_page(viewport=dict(zip(("width", "height"), size, strict=True)))
    page.goto(f"/jobs/{job}")
    expect_frame(page, 1)
    if not page.locator(".display").is_visible():
        page.keyboard.press("t")
    return page


@pytest.mark.parametrize("size", [(1400, 900), (390, 844)], ids=["desk", "phone"])
def test_no_words_are_cut(done, new_page, size):
    """Neither in the display's lists nor on any sheet of the drawer."""
    page = with_display(new_page, done, size)
    expect(page.get_by_label("Pace")).to_be_visible()
    assert page.evaluate(CUT) == []
    for pace in ("Even", "Slow at each shape", "Overshoot"):
        page.get_by_label("Pace").select_option(pace)
        assert page.evaluate(CUT) == []
    for sheet in ("Overview", "Curves", "Settings", "Files"):
        details(page, sheet)
        if sheet == "Settings":
            page.get_by_text(re.compile(r"^All \d+ settings$")).click()
        assert page.evaluate(CUT) == [], sheet


@pytest.mark.parametrize("size", [(1400, 900), (390, 844)], ids=["desk", "phone"])
def test_all_of_the_display_is_in_sight(done, new_page, size):
    """Without scrolling in it, with the controls of a cut and of a pace."""
    page = with_display(new_page, done, size)
    page.get_by_label("Cut", exact=True).select_option("x")
    page.get_by_label("Pace", exact=True).select_option("linear")
    expect(page.get_by_label("Position of the cut")).to_be_visible()
    expect(page.get_by_label("Repeat", exact=True)).to_be_visible()
    display = page.locator(".display")
    assert display.evaluate("one => one.scrollHeight - one.clientHeight") <= 0
    under = display.bounding_box()
    assert under["y"] + under["height"] <= page.locator(".timeline").bounding_box()["y"]


def test_list_of_keys(opened):
    """By its key."""
    opened.keyboard.press("?")
    dialog = opened.get_by_role("dialog")
    expect(dialog).to_contain_text("full screen")
    opened.keyboard.press("Escape")
    expect(dialog).to_be_hidden()


def test_full_screen(opened):
    """By its key; the controls come along."""
    opened.evaluate(ASKED_FOR_FULL_SCREEN)
    opened.keyboard.press("f")
    answer = opened.evaluate("window.answer")
    assert answer != "not asked"
    if answer != "granted":
        pytest.skip(f"This browser does not go full screen: {answer}")
    expect(opened.locator(".stage-window:fullscreen .timeline")).to_be_visible()
    opened.keyboard.press("f")
    expect(opened.locator(":fullscreen")).to_have_count(0)


def test_pictures_and_films_are_saved(opened, tmp_path):
    """The picture is a PNG of the view, the films are WebM."""
    details(opened, "Files")
    shot = saved(opened, "Picture, PNG", tmp_path)
    with Image.open(shot) as image:
        assert image.format == "PNG"
        assert min(image.size) > 200
    film = saved(opened, "Video of the frames, WebM", tmp_path)
    assert film.suffix == ".webm"
    assert film.read_bytes().startswith(b"\x1aE\xdf\xa3")
    expect(opened.get_by_role("button", name="Video of the frames, WebM")).to_be_enabled()


AS_IN_FIREFOX = """
const { requestFrame } = CanvasCaptureMediaStreamTrack.prototype;
delete CanvasCaptureMediaStreamTrack.prototype.requestFrame;
MediaStream.prototype.requestFrame = function () { requestFrame.call(this.getVideoTracks()[0]); };
"""
"""There a stream has what elsewhere its track has."""

NOTES = """() => {
  const note = document.querySelector(".scene-note");
  window.notes = [];
  const options = { childList: true, characterData: true, subtree: true };
  new MutationObserver(() => window.notes.push(note.textContent)).observe(note, options);
}"""
"""Collects what is said below the view."""


@pytest.mark.parametrize("script", ["", AS_IN_FIREFOX], ids=["chromium", "firefox"])
def test_a_film_shows_the_surface_that_is_seen(page, done, tmp_path, script):
    """From its first picture on, though only one surface is here when it is asked for."""
    page.add_init_script(script)
    page.goto(f"/jobs/{done}?quality=sketch&details=files")
    expect(page.locator(".surface-words")).to_contain_text("dx from the target")
    page.evaluate(NOTES)
    film = saved(page, "Video of the frames, WebM", tmp_path)
    assert film.read_bytes().startswith(b"\x1aE\xdf\xa3")
    assert not [note for note in page.evaluate("window.notes") if "Particles" in note]


def test_a_film_that_cannot_be_recorded_is_told_of(opened):
    """And the button is there to try it again."""
    refuse = "MediaRecorder.prototype.start = () => { throw new Error('no encoder'); }"
    opened.evaluate(f"() => {{ {refuse}; }}")
    details(opened, "Files")
    opened.get_by_role("button", name="Turntable, WebM").click()
    expect(opened.get_by_role("alert")).to_contain_text("cannot record videos: no encoder")
    expect(opened.get_by_role("button", name="Turntable, WebM")).to_be_enabled()


def test_a_frame_that_cannot_be_had_is_told_of(page, done):
    """Why, and nothing more once it has come."""
    frame = re.compile("/frames/1\\?")
    problem = {"title": "Broken", "detail": "The frame is broken.", "status": 500}
    page.route(frame, lambda route: route.fulfill(status=500, json=problem))
    page.goto(f"/jobs/{done}?shape=points&quality=sketch")
    expect_frame(page, 1)
    page.get_by_role("button", name="Next frame").click()
    expect(page.locator(".scene-note")).to_contain_text("not available: The frame is broken.")
    page.unroute(frame)
    expect_frame(page, 2)
    expect(page.locator(".scene-note")).to_be_hidden()


def test_an_export_outlives_a_service_that_is_away(opened):
    """It is asked for again until there is an answer."""
    running = {"id": "late", "state": "running", "progress": 0.5}
    ready = {"id": "late", "state": "ready", "file_name": "late.glb", "size": 1}
    answers = [{"status": 503}, {"abort": True}, {"json": ready}]

    def answer(route):
        found = answers.pop(0)
        route.abort() if "abort" in found else route.fulfill(**found)

    opened.route("**/exports", lambda route: route.fulfill(status=202, json=running))
    opened.route("**/exports/late", answer)
    details(opened, "Files")
    opened.get_by_role("button", name="Export").click()
    expect(opened.get_by_role("button", name="Save late.glb, 1 B")).to_be_visible()


def test_times_of_another_day_have_the_day(page, done):
    """A job may take a night."""
    page.clock.set_fixed_time(datetime.now() + timedelta(days=2))
    page.goto(f"/jobs/{done}?details=overview")
    times = page.locator(".history time")
    expect(times.first).to_contain_text(re.compile(r"20\d\d.*\d:\d\d:\d\d"))


def test_a_view_whose_code_is_gone_says_so(browser, service, done):
    """As where the service was upgraded while the page was open: it asks to be loaded again."""
    context = patient(browser.new_context(base_url=service.url))
    page = context.new_page()
    page.route(re.compile("/assets/viewer-.*js"), lambda route: route.fulfill(status=404))
    page.goto(f"/jobs/{done}")
    expect(page.locator(".scene-note")).to_contain_text("A part of the page cannot be loaded")
    page.unroute_all()
    page.get_by_role("button", name="Load again").click()
    expect_frame(page, 1)
    context.close()


def test_downloads_and_exports_can_be_read_back(opened, tmp_path, done, service):
    """The result, the numbers and an export of the frame shown are whole files."""
    particles = service.job(done)["outcome"]["particle_count"]
    details(opened, "Files")
    with h5py.File(saved(opened, re.compile("^Result"), tmp_path)) as result:
        assert result["VTKHDF/Steps"].attrs["NSteps"] == FRAMES
    rows = csv.DictReader(saved(opened, "Metrics, CSV", tmp_path).read_text().splitlines())
    assert [row["frame"] for row in rows] == [str(i) for i in range(FRAMES)]
    expect(opened.get_by_label("Format")).to_have_value("glb")
    expect(opened.get_by_label("Content")).to_have_value("tracked")  # what an artist takes home
    opened.get_by_label("Format").select_option("ply")
    expect(opened.get_by_label("Content")).to_have_value("surface")
    opened.get_by_label("Content").select_option("points")
    opened.get_by_role("button", name="Export").click()
    cloud = trimesh.load(saved(opened, re.compile(r"^Save .*\.ply"), tmp_path))
    assert len(cloud.vertices) == particles
    opened.get_by_label("Format").select_option("pc2")
    expect(opened.get_by_label("Content")).to_be_hidden()  # there is nothing to choose
    opened.get_by_role("button", name="Export").click()
    with zipfile.ZipFile(saved(opened, re.compile(r"^Save .*\.zip"), tmp_path)) as archive:
        assert {"surface.obj", "surface.pc2"} <= {*archive.namelist()}


def test_a_film_of_ones_own(opened, tmp_path):
    """Size, background, playing time and the places of the eye are those chosen in the page."""
    details(opened, "Files")
    opened.get_by_label("Format").select_option("png")
    opened.get_by_label("Pixels").select_option("1080x1080")
    opened.get_by_label("Background", exact=True).select_option("transparent")
    opened.get_by_label("Camera").select_option("keys")
    opened.locator(".scene").focus()
    for side in ("1", "3"):
        opened.keyboard.press(side)
        opened.keyboard.press("Shift+ArrowLeft" if side == "1" else "Shift+ArrowRight")
        expect_frame(opened, 1 if side == "1" else FRAMES)
        opened.get_by_role("button", name="Add this position").click()
        opened.locator(".scene").focus()
    places = opened.locator(".camera-keys li")
    expect(places).to_have_text([re.compile("^0 %: 0° around"), re.compile("^100 %: 90° around")])
    opened.get_by_role("button", name="Export").click()
    expect(opened.get_by_role("button", name=re.compile("^Save "))).to_be_in_viewport()
    with zipfile.ZipFile(saved(opened, re.compile(r"^Save .*\.zip"), tmp_path)) as archive:
        with archive.open("frame-0000.png") as file, Image.open(file) as image:
            assert image.size == (1080, 1080) and image.getpixel((0, 0))[3] == 0
    opened.route("**/exports", lambda route: route.abort())
    opened.get_by_label("Pace").select_option("linear")
    opened.get_by_label("Pauses").select_option("0.5")
    opened.get_by_label("Format").select_option("mp4")
    with opened.expect_request(re.compile("/exports$")) as asked:
        opened.get_by_role("button", name="Export").click()
    body = asked.value.post_data_json
    assert (body["seconds"], body["hold"], body["easing"]) == (5, 0.5, "linear")
    assert (body["picture"]["background"], body["picture"]["width"]) == ("white", 1080)
    assert body["picture"]["camera_keys"][1]["azimuth"] == pytest.approx(90, abs=1)


@pytest.mark.parametrize("up", ["y", "z"])
def test_places_of_the_eye_are_told_from_the_front(opened, up):
    """Front, right and top are at 0 and 90 degrees around and at 90 high, whichever axis is up."""
    opened.get_by_label("Up", exact=True).select_option(up)
    details(opened, "Files")
    opened.get_by_label("Format").select_option("png")
    opened.get_by_label("Camera").select_option("keys")
    for side, words in (
        ("1", "0° around, 0° high"),
        ("3", "90° around, 0° high"),
        ("7", "90° high"),
    ):
        opened.locator(".scene").focus()
        opened.keyboard.press(side)
        opened.get_by_role("button", name="Add this position").click()
        expect(opened.locator(".camera-keys li")).to_contain_text(words)


def test_lines_say_which_frame_they_are_about(page, done):
    """Of a job that opens at its first frame: numbers of the last one, the surface of the first."""
    page.goto(f"/jobs/{done}?details=overview")
    expect(page.get_by_role("heading", name=f"Frame {FRAMES}, the last")).to_be_visible()
    words = page.locator(".surface-words")
    expect(words).to_contain_text(re.compile("^Frame 1: closed surface, .* dx from the target"))
    page.keyboard.press("Shift+ArrowRight")
    expect(words).to_contain_text(re.compile(f"^Frame {FRAMES}: closed surface"))


TORN = """() => [...document.querySelectorAll(".sheet th code")]
  .flatMap((code) => [...code.childNodes].filter((one) => one.nodeType === Node.TEXT_NODE))
  .filter((text) => {
    const range = document.createRange();
    range.selectNodeContents(text);
    return range.getClientRects().length > 1;
  })
  .map((text) => text.textContent)"""
"""Parts of names that go on in the next line."""


@pytest.mark.parametrize("size", [(1400, 900), (390, 844)], ids=["desk", "phone"])
def test_names_of_settings_break_where_their_parts_end(done, new_page, size):
    """Long values give way to them."""
    page = new_page(viewport=dict(zip(("width", "height"), size, strict=True)))

    def lengthen(route):
        answer = route.fetch()
        names = [{"name": "a landmark", "source": [0.123456789, 1.5, 2], "target": [3, 4, 5]}] * 3
        route.fulfill(response=answer, json=answer.json() | {"landmarks": names})

    page.route("**/config", lengthen)
    page.goto(f"/jobs/{done}?details=settings")
    page.get_by_text(re.compile(r"^All \d+ settings$")).click()
    expect(page.locator(".sheet th code").last).to_have_text("landmarks")
    assert page.evaluate(TORN) == []
    assert page.evaluate(CUT) == []


def test_the_numbers_are_a_table_too(opened):
    """Curves are there for people who do not see them."""
    details(opened, "Curves")
    opened.get_by_text("All numbers as a table").click()
    table = opened.get_by_role("region", name="Metrics by frame")
    expect(table.get_by_role("row")).to_have_count(FRAMES + 1)
    expect(table.get_by_role("columnheader", name="two_sided", exact=True)).to_be_visible()


def test_a_restart_of_the_service_loses_nothing(new_service, new_page):
    """While the service is away the page says so; then it goes on, with every frame."""
    frames = 12
    own = new_service()
    page = new_page(of=own)
    slow = {"sampling.points_per_cell_edge": 1, "points.steps_per_frame": 400}
    job = own.submit(name="through a restart", frames=frames, method="dco", overrides=slow)
    page.goto(f"/jobs/{job}?details=curves&shape=points")
    reading = page.locator(".timeline output")
    expect(reading).to_have_text(re.compile(r"[1-9]\d* / "), timeout=1000 * COMPILING)
    notice = page.locator("#main .notice").get_by_text("The service does not answer.")
    own.stop()
    expect(notice).to_be_visible()
    own.start()
    expect(notice).to_be_hidden()
    expect(page.locator(".summary")).to_contain_text("Succeeded", timeout=1000 * COMPILING)
    expect_frame(page, frames, of=frames)
    page.get_by_text("All numbers as a table").click()
    rows = page.get_by_role("region", name="Metrics by frame").get_by_role("row")
    expect(rows).to_have_count(frames + 1)


def test_two_tabs_agree(service, new_page):
    """What one tab does to a job, the other one shows."""
    job = service.submit(name="seen twice", frames=MANY)
    one, two = new_page(), new_page()
    for tab in (one, two):
        tab.goto(f"/jobs/{job}?details=overview")
        expect(tab.locator(".summary")).to_contain_text("Running")
    one.get_by_role("button", name="Cancel").click()
    for tab in (one, two):
        expect(tab.locator(".summary")).to_contain_text("Cancelled")
    two.get_by_role("button", name="Delete").click()
    two.get_by_role("dialog").get_by_role("button", name="Delete").click()
    two.wait_for_url(re.compile(r"/$"))
    expect(one.get_by_role("alert")).to_contain_text("There is no job")


def test_the_keyboard_is_enough(opened):
    """Camera, time and cut, each reached with the Tab key."""

    def tab_to(selector: str) -> None:
        for _ in range(60):
            opened.keyboard.press("Tab")
            if opened.evaluate("(s) => document.activeElement.matches(s)", selector):
                return
        pytest.fail(f"Tab never comes to {selector}.")

    tab_to(".scene")
    opened.keyboard.press("Home")
    before = picture(opened)
    for _ in range(5):
        opened.keyboard.press("4")
    turned = changed(opened, before)
    opened.keyboard.press("7")
    changed(opened, turned)
    opened.keyboard.press("Home")
    assert picture(opened) == before
    opened.keyboard.press("Shift+ArrowLeft")
    expect_frame(opened, 1)
    opened.keyboard.press("Space")
    expect_frame(opened, FRAMES)
    tab_to(".timeline input[type=range]")
    opened.keyboard.press("ArrowLeft")
    expect_frame(opened, FRAMES - 1)
    opened.keyboard.press("Space")
    expect_frame(opened, FRAMES)
    tab_to("#display-axis")
    opened.keyboard.press("ArrowDown")
    expect(opened.get_by_label("Position of the cut")).to_be_visible()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious(done, new_page, serious_faults, scheme):
    """No serious finding of axe-core, in any sheet of the drawer, with everything unfolded."""
    page = new_page(color_scheme=scheme)
    page.goto(f"/jobs/{done}?details=overview")
    expect_frame(page, 1)
    assert serious_faults(page) == []
    details(page, "Curves")
    page.get_by_text("All numbers as a table").click()
    assert serious_faults(page) == []
    details(page, "Settings")
    page.get_by_text(re.compile(r"^All \d+ settings$")).click()
    assert serious_faults(page) == []
    details(page, "Files")
    assert serious_faults(page) == []


def test_a_phone_needs_no_sideways_scroll(done, new_page):
    """At 390 px nothing is wider than the screen."""
    page = new_page(viewport={"width": 390, "height": 844}, has_touch=True)
    page.goto(f"/jobs/{done}?details=curves")
    expect_frame(page, 1)
    page.get_by_text("All numbers as a table").click()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_phone_follows_a_job(service, new_page):
    """With the button that leads to the newest frame nothing is wider than the screen, either."""
    job = service.submit(name="followed by phone", frames=MANY)
    page = new_page(viewport={"width": 390, "height": 844}, has_touch=True)
    page.goto(f"/jobs/{job}")
    expect(page.get_by_role("button", name="Newest frame")).to_be_visible()
    expect(page.locator(".summary")).to_contain_text("Running")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    service.call("POST", f"/v1/jobs/{job}/cancel")
