"""The list of jobs, as a person uses it."""

from __future__ import annotations

import re
from datetime import datetime, timedelta

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

MANY = 2000
"""Frames of a job that lasts until it is cancelled."""


@pytest.fixture(scope="module")
def finished(service):
    """A job that succeeded."""
    job = service.submit(name="a finished one")
    service.wait_for(job, "succeeded")
    return job


def row(page, name):
    """The row of a job by its name."""
    return page.get_by_role("row").filter(has=page.get_by_role("link", name=name, exact=True))


def test_an_empty_list_invites_to_a_first_morph(new_service, new_page):
    """One click on an empty page makes a job and shows it."""
    empty = new_service(workers=0)
    page = new_page(of=empty)
    page.goto("/")
    page.get_by_role("button", name="Morph a sphere into a star").dblclick()
    page.wait_for_url("**/jobs/*")
    jobs = empty.call("GET", "/v1/jobs").json()["items"]
    assert [(job["source_name"], job["target_name"]) for job in jobs] == [("sphere", "star")]


def test_a_job_moves_through_the_list_by_itself(service, page):
    """Without a reload, a job submitted elsewhere appears, ends, and says how good it is."""
    page.goto("/")
    expect(page.get_by_role("heading", name="Jobs")).to_be_visible()
    service.submit(name="seen from afar")
    found = row(page, "seen from afar")
    expect(found).to_contain_text("Succeeded")
    expect(found).to_contain_text("3 frames in")
    expect(found.locator(".quality")).to_have_text(re.compile(r"^\d+ % filled$"))


LOOKED_TWICE = 5000
"""In this time [ms] the list asks how its jobs are at least twice."""


@pytest.mark.usefixtures("queue_goes_on")
def test_a_press_is_a_click_whatever_happens_to_the_job(service, page):
    """What lies under the pointer stays there until it is let go."""
    service.pause_queue()
    job = service.submit(name="to be pressed")
    page.goto("/")
    row(page, "to be pressed").get_by_role("link", name="Change").hover()
    page.mouse.down()
    service.call("POST", f"/v1/jobs/{job}/cancel")
    service.unpause_queue()
    page.wait_for_timeout(LOOKED_TWICE)
    page.mouse.up()
    page.wait_for_url(f"**/new?like={job}")


@pytest.mark.usefixtures("queue_goes_on")
def test_the_list_goes_on_after_a_press(service, page):
    """Also where the press was no click."""
    service.pause_queue()
    job = service.submit(name="pressed beside")
    page.goto("/")
    found = row(page, "pressed beside")
    expect(found).to_contain_text("Paused")
    page.get_by_role("heading", name="Jobs").hover()
    page.mouse.down()
    service.call("POST", f"/v1/jobs/{job}/cancel")
    page.wait_for_timeout(LOOKED_TWICE)
    expect(found).to_contain_text("Paused")
    page.mouse.up()
    expect(found).to_contain_text("Cancelled")


def test_cancel_resume_retry_and_delete(service, page):
    """What a person may do with a job follows from its state, and does what it says."""
    job = service.submit(name="to be handled", frames=MANY)
    page.goto("/")
    found = row(page, "to be handled")
    found.get_by_role("button", name="Cancel").click()
    expect(found).to_contain_text("Cancelled")
    expect(found.get_by_role("button", name="Cancel")).to_have_count(0)

    found.get_by_role("button", name="Resume").click()
    expect(found).to_contain_text(re.compile("Queued|Running"))
    expect(found).to_contain_text(re.compile(r"[1-9]\d* of 2"))
    found.get_by_role("button", name="Cancel").click()
    expect(found).to_contain_text("Cancelled")

    service.wait_for(job, "cancelled")
    found.get_by_role("button", name="Retry").click()
    page.get_by_role("dialog").get_by_role("button", name="Retry").click()
    expect(found).to_contain_text(re.compile("Queued|Running"))
    found.get_by_role("button", name="Cancel").click()
    expect(found).to_contain_text("Cancelled")

    found.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Keep it").click()
    expect(found.get_by_role("button", name="Delete")).to_be_focused()
    found.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(found).to_have_count(0)
    assert service.call("GET", f"/v1/jobs/{job}").status_code == 404


def test_filters_live_in_the_address(service, finished, page):
    """Filters by state and method choose the rows, and a reload keeps them."""
    page.goto("/")
    expect(row(page, "a finished one")).to_be_visible()
    page.get_by_role("button", name="Timed out", exact=True).click()
    expect(page.get_by_text("No jobs match.")).to_be_visible()
    page.get_by_role("button", name="Succeeded", exact=True).click()
    expect(row(page, "a finished one")).to_be_visible()
    page.get_by_label("Method").select_option("swd")
    expect(page.get_by_text("No jobs match.")).to_be_visible()
    page.get_by_label("Method").select_option("physics")
    expect(row(page, "a finished one")).to_be_visible()

    page.reload()
    expect(row(page, "a finished one")).to_be_visible()
    expect(page.get_by_role("button", name="Timed out", exact=True)).to_have_attribute(
        "aria-pressed", "true"
    )
    expect(page.get_by_label("Method")).to_have_value("physics")


def test_older_jobs_are_on_further_pages(new_service, new_page):
    """Twenty jobs make a page; the address of the next one works by itself."""
    crowded = new_service(workers=0)
    for number in range(22):
        crowded.submit(name=f"number {number}")
    page = new_page(of=crowded)
    page.goto("/")
    expect(page.get_by_role("link", name=re.compile(r"^number \d+$"))).to_have_count(20)
    page.get_by_role("link", name="Older").click()
    expect(page.get_by_role("link", name=re.compile(r"^number \d+$"))).to_have_text(
        ["number 1", "number 0"]
    )
    page.reload()
    expect(page.get_by_role("link", name=re.compile(r"^number \d+$"))).to_have_count(2)
    page.get_by_role("link", name="Newest").click()
    expect(row(page, "number 21")).to_be_visible()
    page.get_by_role("button", name="Queued", exact=True).click()
    older = page.get_by_role("link", name="Older")
    expect(older).to_have_attribute("href", re.compile("state=queued"))


def test_no_more_jobs_are_chosen_than_fit(new_service, new_page):
    """With four chosen, no other can be, not even one that comes later."""
    crowded = new_service(workers=0)
    for number in range(4):
        crowded.submit(name=f"chosen {number}")
    page = new_page(of=crowded)
    page.goto("/")
    for number in range(4):
        page.get_by_role("checkbox", name=f"Compare chosen {number}").check()
    crowded.submit(name="one too many")
    expect(page.get_by_role("checkbox", name="Compare one too many")).to_be_disabled()


def test_two_jobs_are_chosen_for_comparison(service, finished, page):
    """Two check marks lead to the comparison of these two."""
    other = service.submit(name="another finished one", method="dco")
    service.wait_for(other, "succeeded")
    page.goto("/")
    page.get_by_role("checkbox", name="Compare a finished one").check()
    page.get_by_role("checkbox", name="Compare another finished one").check()
    page.get_by_role("link", name="Compare", exact=True).click()
    page.wait_for_url(f"**/compare?jobs={finished},{other}")


def test_a_lost_service_is_told_and_found_again(new_service, new_page):
    """While the service is away the page says so, keeps what it showed, and recovers."""
    frail = new_service(workers=0)
    frail.submit(name="before the loss")
    page = new_page(of=frail)
    page.goto("/")
    expect(row(page, "before the loss")).to_be_visible()
    frail.stop()
    expect(page.get_by_role("alert")).to_contain_text("The service does not answer.")
    expect(row(page, "before the loss")).to_be_visible()
    frail.start()
    expect(page.get_by_role("alert")).to_have_count(0)


def test_an_answer_that_breaks_off_ends_no_watch(page, service):
    """The list is asked for again when the body of a refusal does not come."""
    job = service.submit(name="after the fault")
    page.add_init_script("Response.prototype.text = () => Promise.reject(new TypeError('cut'));")
    listed = re.compile(r"/v1/jobs\?")
    page.route(listed, lambda route: route.fulfill(status=503))
    page.goto("/")
    expect(page.get_by_role("alert")).to_contain_text("The service does not answer.")
    page.unroute(listed)
    expect(row(page, "after the fault")).to_be_visible()
    service.wait_for(job, "succeeded")


def test_keys_are_asked_for_and_kept_for_the_tab(new_service, new_page):
    """With keys, the page asks once, tells that a wrong one is wrong, and survives a reload."""
    guarded = new_service(workers=0)
    guarded.submit(name="made before the keys")
    made = guarded.call("POST", "/v1/keys", json={"name": "boss", "scopes": ["admin"]})
    page = new_page(of=guarded)
    page.goto("/")
    page.get_by_role("button", name="Not now").click()
    expect(page.get_by_role("alert")).to_contain_text("This requires a key.")
    page.get_by_role("button", name="Enter key").click()
    page.get_by_label("API key").fill("not-a-key")
    page.get_by_role("button", name="Use this key").click()
    expect(page.get_by_role("dialog")).to_contain_text("unknown or revoked")
    page.get_by_label("API key").fill(made.json()["secret"])
    page.get_by_role("button", name="Use this key").click()
    expect(row(page, "made before the keys")).to_be_visible()
    page.reload()
    expect(row(page, "made before the keys")).to_be_visible()
    page.get_by_role("button", name="Forget key").click()
    expect(page.get_by_label("API key")).to_be_visible()


def test_the_own_queue_is_paused_and_goes_on(new_service, new_page):
    """The list says that it is paused, whoever did it, and ends the pause."""
    waiting = new_service(workers=0)
    page = new_page(of=waiting)
    page.goto("/")
    expect(page.get_by_text("Nothing has been morphed yet")).to_be_visible()
    expect(page.get_by_role("button", name="Pause my queue")).to_have_count(0)
    waiting.submit(name="one that waits")
    page.get_by_role("button", name="Pause my queue").click()
    expect(page.get_by_text("Your queue is paused. 1 job of yours will wait")).to_be_visible()
    expect(row(page, "one that waits")).to_contain_text("Paused")
    assert waiting.call("GET", "/v1/queue").json()["paused"]
    expect(page.get_by_role("button", name="Unpause")).to_be_focused()
    page.get_by_role("button", name="Unpause").press("Enter")
    expect(row(page, "one that waits")).to_contain_text("Next in the queue")
    waiting.pause_queue()
    expect(page.get_by_role("button", name="Unpause")).to_be_visible()


RECORD = """window.Notification = class extends Notification {
  constructor(title, options) {
    super(title, options);
    const { dataset } = document.documentElement;
    dataset.shown = `${dataset.shown ?? ""}${title}: ${options.body}.`;
  }
};"""
"""Real notifications, whose words can be read."""


def test_a_notification_when_a_job_ends(service, new_page):
    """Only once it was asked for, also after a reload; a job that was over before is no news.

    The clock of the page is none of the service's.
    """
    service.wait_for(service.submit(name="over before"), "succeeded")
    page = new_page(permissions=["notifications"])
    page.clock.set_fixed_time(datetime.now() + timedelta(hours=1))
    page.add_init_script(RECORD)
    page.goto("/")
    bell = page.get_by_role("button", name="Notify me when a job ends")
    expect(bell).to_have_attribute("aria-pressed", "false")
    service.wait_for(service.submit(name="unasked"), "succeeded")
    bell.click()
    expect(bell).to_have_attribute("aria-pressed", "true")
    with page.expect_response(re.compile(r"/v1/jobs\?")):
        page.goto("/new")
    expect(bell).to_have_attribute("aria-pressed", "true")
    service.submit(name="awaited")
    expect(page.locator("html")).to_have_attribute("data-shown", "awaited: Succeeded.")
    bell.click()
    expect(bell).to_have_attribute("aria-pressed", "false")


def test_no_notifications_are_offered_where_a_page_has_none(new_page):
    """In Chrome on Android only service workers may show any."""
    page = new_page(
        user_agent="Mozilla/5.0 (Linux; Android 14) Chrome/140.0.0.0 Mobile Safari/537.36"
    )
    page.goto("/")
    expect(page.get_by_role("button", name="Dark colours")).to_be_visible()
    expect(page.get_by_role("button", name="Notify me when a job ends")).to_be_hidden()


def test_notifications_that_are_blocked(service, new_page):
    """A person who wants them is told why there are none."""
    page = new_page(permissions=[])
    page.goto("/")
    page.get_by_role("button", name="Notify me when a job ends").click()
    expect(page.get_by_role("dialog")).to_contain_text("Allow them in its settings")
    page.get_by_role("button", name="Close").click()
    bell = page.get_by_role("button", name="Notify me when a job ends")
    expect(bell).to_have_attribute("aria-pressed", "false")
