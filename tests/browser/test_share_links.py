"""Share links: made in one browser, opened in another without a key, until they are revoked."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def finished(service):
    """A job that has succeeded."""
    job = service.submit(name="to be shown")
    service.wait_for(job, "succeeded")
    return job


def make_link(page, job):
    """Make a link in the drawer of a job, and answer its address."""
    page.goto(f"/jobs/{job}?details=overview")
    page.get_by_role("button", name="Make a link").click()
    return page.get_by_label("Address of the link").input_value()


def expect_the_morph(page):
    """The job is drawn, and its frames can be gone through."""
    expect(page.get_by_role("heading", level=1)).to_have_text("to be shown")
    expect(page.locator("canvas").first).to_be_visible()
    expect(page.get_by_role("slider", name="Frame")).to_have_attribute("max", "2")


def test_a_link_is_made_copied_and_revoked(service, finished, new_page):
    """The copied address is the one that is shown; a revoked link is gone from list and service."""
    page = new_page(permissions=["clipboard-read", "clipboard-write"])
    url = make_link(page, finished)
    assert url.startswith(f"{service.url}/shared/{finished}#share_")
    page.get_by_role("button", name="Copy").click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    assert page.evaluate("navigator.clipboard.readText()") == url

    page.reload()
    expect(page.locator(".share-links li")).to_have_count(1)
    expect(page.get_by_label("Address of the link")).to_have_count(0)
    page.get_by_role("button", name="Revoke the link").click()
    page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
    expect(page.locator(".share-links li")).to_have_count(0)
    expect(page.get_by_role("button", name="Make a link")).to_be_focused()
    assert service.call("GET", f"/v1/jobs/{finished}/share-links").json() == []


def test_a_double_click_makes_one_link(finished, page):
    """While the first one is on its way, another click makes none."""
    held = []
    page.goto(f"/jobs/{finished}?details=overview")
    expect(page.get_by_role("button", name="Make a link")).to_be_visible()
    page.route("**/share-links", lambda route: held.append(route))
    with page.expect_request("**/share-links"):
        page.get_by_role("button", name="Make a link").dblclick()
    held.pop().fulfill(status=201, json={"id": "a", "created_at": "2026-01-01", "path": "/shared"})
    expect(page.get_by_label("Address of the link")).to_have_count(1)
    assert held == []


def test_without_a_key_a_link_shows_its_job_alone(new_service, new_page):
    """No dialog asks for a key; nothing can be changed; a reload and the address keep the link."""
    service = new_service()
    job = service.submit(name="to be shown")
    service.wait_for(job, "succeeded")
    key = service.call("POST", "/v1/keys", json={"name": "root", "scopes": ["admin"]})
    secret = {"Authorization": f"Bearer {key.json()['secret']}"}
    link = service.call("POST", f"/v1/jobs/{job}/share-links", headers=secret).json()

    page = new_page(of=service)
    refused = []
    page.on("response", lambda answer: answer.status >= 400 and refused.append(answer.url))
    page.goto(link["path"])
    expect_the_morph(page)
    for sheet in ("Overview", "Curves", "Settings", "Files"):
        if sheet == "Overview":
            page.get_by_role("button", name="Details", exact=True).click()
        page.get_by_role("tab", name=sheet).click()
        expect(page.get_by_role("tabpanel", name=sheet)).to_be_visible()
    for name in ("Retry", "Delete", "Change", "Compare", "Make a link", "Export", "Log"):
        expect(page.get_by_role("button", name=name)).to_have_count(0)
    expect(page.get_by_role("link", name="Jobs")).to_have_count(0)
    with page.expect_download() as download:
        page.get_by_role("button", name="Result, VTKHDF").click()
    assert download.value.suggested_filename.endswith(".vtkhdf")
    assert link["secret"] in page.url
    page.get_by_role("link", name="Skip to content").focus()
    page.keyboard.press("Enter")
    assert link["secret"] not in page.url
    page.reload()
    expect_the_morph(page)
    assert refused == []
    expect(page.get_by_role("dialog")).to_have_count(0)

    service.call("DELETE", f"/v1/jobs/{job}/share-links/{link['id']}", headers=secret)
    page.reload()
    expect(page.get_by_role("alert")).to_contain_text("unknown or revoked")
    expect(page.get_by_role("dialog")).to_have_count(0)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
def test_axe_finds_nothing_serious(finished, new_page, serious_faults, scheme, width):
    """Neither where links are made, nor where one is opened."""
    viewport = {"width": width, "height": 900}
    page = new_page(color_scheme=scheme, viewport=viewport)
    url = make_link(page, finished)
    assert serious_faults(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    visitor = new_page(color_scheme=scheme, viewport=viewport)
    visitor.goto(url)
    expect_the_morph(visitor)
    assert serious_faults(visitor) == []
    assert visitor.evaluate("document.documentElement.scrollWidth") <= width
