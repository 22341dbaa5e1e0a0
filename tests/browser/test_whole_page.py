"""What holds for every view: readable by all, small, for itself, on a phone."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.patience import patient

pytestmark = pytest.mark.browser

FIRST_VIEW_BYTES = 400_000


@pytest.fixture(scope="module")
def settled(service):
    """Jobs in several states, none of which changes any more."""
    done = service.submit(name="a job that is done")
    stopped = service.submit(name="a job that was stopped", frames=2000)
    service.wait_for(done, "succeeded")
    service.call("POST", f"/v1/jobs/{stopped}/cancel")
    service.wait_for(stopped, "cancelled")
    return service


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("path", ["/", "/new"])
def test_axe_finds_nothing_serious(settled, new_page, serious_faults, path, scheme):
    """No serious finding of axe-core, with the settings open too, in light and in dark."""
    page = new_page(color_scheme=scheme)
    page.goto(path)
    if path.startswith("/new"):
        page.get_by_text("Research", exact=True).click()
        page.get_by_text("All settings").click()
        expect(page.locator("canvas").first).to_be_visible()
    else:
        expect(page.get_by_role("row").nth(2)).to_be_visible()
    assert serious_faults(page) == []


@pytest.mark.parametrize("path", ["/", "/new"])
def test_a_phone_needs_no_sideways_scroll(settled, new_page, path):
    """At 390 px nothing is wider than the screen."""
    page = new_page(viewport={"width": 390, "height": 844}, has_touch=True)
    page.goto(path)
    if path == "/new":
        page.get_by_text("Research", exact=True).click()
        page.get_by_text("All settings").click()
    else:
        expect(page.get_by_role("link", name="a job that is done", exact=True)).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_the_first_view_is_small_and_needs_nobody_else(settled, page):
    """Less than 400 kB compressed, pictures included, and interactive without another host."""
    finished = []
    page.on("requestfinished", lambda request: finished.append(request))
    page.goto("/")
    expect(page.get_by_role("link", name="a job that is done", exact=True)).to_be_visible()
    expect(page.locator(".thumbnail img").first).to_be_visible()
    sizes = {request.url: request.sizes()["responseBodySize"] for request in list(finished)}
    assert any(url.endswith(".js") for url in sizes)
    assert sum(sizes.values()) < FIRST_VIEW_BYTES, sizes


def test_light_and_dark_are_chosen_and_kept(page):
    """The switch overrides the system and outlives a reload."""
    page.emulate_media(color_scheme="light")
    page.goto("/")
    background = "getComputedStyle(document.documentElement).backgroundColor"
    light = page.evaluate(background)
    page.get_by_role("button", name="Dark colours").click()
    dark = page.evaluate(background)
    assert dark != light
    page.reload()
    expect(page.get_by_role("button", name="Light colours")).to_be_visible()
    assert page.evaluate(background) == dark


def test_no_line_lies_below_the_header(page):
    """The view that has the focus when it opens has no ring, whatever key is pressed."""
    page.goto("/")
    page.get_by_role("link", name="Gallery").click()
    expect(page.get_by_role("heading", name="Gallery")).to_be_visible()
    page.keyboard.press("Shift")
    main = page.locator("main")
    expect(main).to_be_focused()
    assert main.evaluate("one => one.matches(':focus-visible')")
    assert main.evaluate("one => getComputedStyle(one).outlineStyle") == "none"


def test_an_unknown_address_says_so(page):
    """Where nothing is, and a job that does not exist: a sentence, not an empty page."""
    assert page.goto("/nothing/here").status == 404
    expect(page.get_by_role("heading", name="There is nothing here")).to_be_visible()
    page.goto("/jobs/00000000000000000000000000")
    expect(page.get_by_role("alert")).to_contain_text("There is no job")


def test_a_view_that_cannot_be_loaded_says_so(browser, service):
    """As where the service was upgraded while the page was open: it asks to be loaded again."""
    context = patient(browser.new_context(base_url=service.url))
    page = context.new_page()
    page.route(re.compile("/assets/gallery-.*js"), lambda route: route.fulfill(status=404))
    page.goto("/")
    page.get_by_role("link", name="Gallery").click()
    expect(page.get_by_role("alert")).to_contain_text("A part of the page cannot be loaded")
    page.unroute_all()
    page.get_by_role("button", name="Load again").click()
    expect(page.get_by_role("heading", name="Gallery")).to_be_visible()
    context.close()


def test_the_policy_forbids_foreign_and_inline_code(service):
    """Scripts come from the service alone, and no frame may hold the page."""
    answer = service.call("GET", "/")
    policy = answer.headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
