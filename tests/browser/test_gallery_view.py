"""The gallery of finished morphs."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def hung(service):
    """Two finished morphs, and a job that was cancelled."""
    for name in ("the first picture", "the second picture"):
        service.wait_for(service.submit(name=name), "succeeded")
    stopped = service.submit(name="no picture", frames=2000)
    service.call("POST", f"/v1/jobs/{stopped}/cancel")
    service.wait_for(stopped, "cancelled")


def cards(page):
    """The links around the pictures."""
    return page.get_by_role("link").filter(has=page.locator("img"))


def test_finished_morphs_are_pictures_that_open(hung, page):
    """The newest first, without those that did not succeed; keys alone suffice."""
    page.goto("/")
    page.get_by_role("link", name="Gallery").click()
    expect(page.get_by_role("heading", name="Gallery")).to_be_visible()
    expect(cards(page).first).to_contain_text("the second picture")
    expect(page.get_by_text("no picture")).to_have_count(0)
    assert page.evaluate("document.querySelector('.cards img').naturalWidth") == 240
    page.get_by_role("link", name=re.compile("the first picture")).focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_have_text("the first picture")
    page.go_back()
    expect(cards(page).first).to_contain_text("the second picture")


def test_a_gallery_without_pictures_says_so(new_service, new_page):
    """And leads to a first one."""
    page = new_page(of=new_service(workers=0))
    page.goto("/gallery")
    expect(page.get_by_text("No morph has succeeded yet.")).to_be_visible()
    page.get_by_role("main").get_by_role("link", name="New morph").click()
    expect(page).to_have_url(re.compile("/new$"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
def test_it_is_readable_by_all(hung, new_page, serious_faults, scheme, width):
    """No serious finding of axe-core, and no sideways scroll."""
    page = new_page(color_scheme=scheme, viewport={"width": width, "height": 844})
    page.goto("/gallery")
    expect(cards(page).nth(1)).to_be_visible()
    assert serious_faults(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
