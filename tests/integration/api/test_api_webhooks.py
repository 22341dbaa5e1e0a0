"""Webhooks by REST: whose they are, what is refused, pages of their log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import sqlalchemy as sa

from chamfer_morph.schemas import DeliveryAttempt, JobState
from chamfer_morph.server.quotas import PENDING_TESTS
from tests.integration.api.conftest import Api

URL = "https://8.8.8.8/morph"


def keys(api: Api) -> list[dict[str, str]]:
    """Headers of an admin and two others."""
    headers: list[dict[str, str]] = []
    for name, scope in (("root", "admin"), ("ann", "submit"), ("bob", "submit")):
        body = {"name": name, "scopes": [scope]}
        answer = api.http.post("/v1/keys", json=body, headers=headers[0] if headers else None)
        headers.append({"Authorization": f"Bearer {answer.json()['secret']}"})
    return headers


def test_whose_they_are(either: Api) -> None:
    """A key sees and deletes its own, an admin all; they go with their key."""
    root, ann, bob = keys(either)
    made = either.http.post("/v1/webhooks", json={"url": URL}, headers=ann)
    assert made.status_code == 201 and made.json()["secret"].startswith("whsec_")
    assert made.json()["states"] == [state.value for state in JobState if state.finished]
    path = made.headers["Location"]
    for headers, status in ((ann, 200), (bob, 404), (root, 200)):
        assert either.http.get(path, headers=headers).status_code == status
        assert len(either.http.get("/v1/webhooks", headers=headers).json()) == (status == 200)
        answer = either.http.post(f"{path}/test", headers=headers)
        assert answer.status_code == (202 if status == 200 else 404)
    assert "secret" not in either.http.get(path, headers=ann).json()
    assert either.http.delete(path, headers=bob).status_code == 404
    assert either.http.delete("/v1/keys/ann", headers=root).status_code == 204
    assert either.http.get("/v1/webhooks", headers=root).json() == []
    own = either.http.post("/v1/webhooks", json={"url": URL}, headers=bob).headers["Location"]
    assert either.http.delete(own, headers=bob).status_code == 204
    assert either.http.get(own, headers=bob).status_code == 404


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"url": "http://127.0.0.1/"}, "not a public address"),
        ({"url": "http://localhost:8000/"}, "not a public address"),
        ({"url": "http://169.254.169.254/latest"}, "not a public address"),
        ({"url": "http://[::ffff:10.0.0.1]/"}, "not a public address"),
        ({"url": "http://[fec0::1]/"}, "not a public address"),
        ({"url": "http://192.0.0.192/"}, "not a public address"),
        ({"url": "http://xn--a/"}, "cannot be read"),
        ({"url": "gopher://8.8.8.8/"}, "http"),
        ({"url": "http://ann:word@8.8.8.8/"}, "password"),
        ({"states": ["done"]}, "states"),
        ({"states": []}, "states"),
        ({"secret": "whsec_c2hvcnQ="}, "24 to 64"),
        ({"retries": 3}, "retries"),
    ],
)
def test_what_is_refused(api: Api, change: dict[str, Any], words: str) -> None:
    """With the cause, and nothing is stored."""
    answer = api.http.post("/v1/webhooks", json={"url": URL} | change)
    problem = answer.json()
    assert answer.status_code == 422, problem
    assert words in problem["detail"] + problem["remedy"]
    assert api.http.get("/v1/webhooks").json() == []


def test_so_many_tests_wait(either: Api) -> None:
    """One more is refused until one of them is delivered or given up."""
    path = either.http.post("/v1/webhooks", json={"url": URL}).headers["Location"]
    answers = [either.http.post(f"{path}/test") for _ in range(PENDING_TESTS + 1)]
    assert [answer.status_code for answer in answers] == [202] * PENDING_TESTS + [429]
    (due,) = either.context.webhooks.due([], 10)
    given_up = DeliveryAttempt(at=due.created_at, seconds=1, status=500, problem="busy")
    either.context.webhooks.record(due, given_up, None)
    assert [either.http.post(f"{path}/test").status_code for _ in range(2)] == [202, 429]


def test_messages_to_no_webhook_hold_up_no_other(either: Api) -> None:
    """A job that changes its state while its owner deletes a webhook may leave such messages."""
    webhooks = either.context.webhooks
    gone = [webhooks.add("ann", URL, [], "secret") for _ in range(3)]
    for webhook in gone:
        assert webhooks.add_test(webhook.id)
    with either.context.engine.begin() as connection:
        connection.execute(sa.text("delete from morph_webhooks"))
    assert webhooks.add_test(gone[0].id) is None
    there = webhooks.add("bob", URL, [], "secret")
    assert webhooks.add_test(there.id)
    assert [message.webhook for message in webhooks.due((), 2)] == [there.id]
    webhooks.forget_old()
    count = sa.text("select count(*) from morph_webhook_messages")
    with either.context.engine.connect() as connection:
        assert connection.execute(count).scalar_one() == 1


def test_a_damaged_row_hides_no_other(either: Api) -> None:
    """States that are none are left out, and so are attempts that cannot be read."""
    paths = [
        either.http.post("/v1/webhooks", json={"url": URL}).headers["Location"] for _ in range(2)
    ]
    sent = [either.http.post(f"{paths[0]}/test").json()["id"] for _ in range(3)]
    broken = "{" if either.context.engine.dialect.name == "sqlite" else "{}"
    with either.context.engine.begin() as connection:
        damage = sa.text("update morph_webhook_messages set attempts = :attempts where id = :id")
        for message, attempts in ((sent[0], broken), (sent[1], '[{"at": 1}]')):
            connection.execute(damage, {"attempts": attempts, "id": message})
        damage = sa.text("update morph_webhooks set states = 'done failed' where id = :id")
        connection.execute(damage, {"id": paths[0].rpartition("/")[2]})
    listed = either.http.get("/v1/webhooks").json()
    assert [webhook["states"] for webhook in listed] == [
        ["failed"], [state.value for state in JobState if state.finished],
    ]  # fmt: skip
    deliveries = either.http.get(f"{paths[0]}/deliveries").json()["items"]
    assert {delivery["id"] for delivery in deliveries} == {*sent}
    assert all(delivery["attempts"] == [] for delivery in deliveries)
    webhooks = either.context.webhooks
    (due,) = webhooks.due([], 10)
    attempt = DeliveryAttempt(at=due.created_at, seconds=1, status=500, problem="busy")
    webhooks.record(due, attempt, None)
    deliveries = either.http.get(f"{paths[0]}/deliveries").json()["items"]
    assert sorted(len(delivery["attempts"]) for delivery in deliveries) == [0, 0, 1]


def test_a_host_that_is_not_found_yet_is_taken(api: Api) -> None:
    """Its messages wait, and the log says why."""
    answer = api.http.post("/v1/webhooks", json={"url": "https://none.invalid/morph"})
    assert answer.status_code == 201


def test_how_many(make_api: Callable[..., Api]) -> None:
    """A key may have so many."""
    api = make_api(webhooks_per_key=2)
    for status in (201, 201, 429):
        answer = api.http.post("/v1/webhooks", json={"url": URL})
        assert answer.status_code == status
    assert "the limit is 2" in answer.json()["detail"]


def test_pages_of_the_log(either: Api) -> None:
    """Each message once, the newest first."""
    path = either.http.post("/v1/webhooks", json={"url": URL}).headers["Location"]
    sent = [either.http.post(f"{path}/test").json()["id"] for _ in range(5)]
    found: list[dict[str, Any]] = []
    cursor = None
    while True:
        query = {"limit": 2} | ({"cursor": cursor} if cursor else {})
        page = either.http.get(f"{path}/deliveries", params=query).json()
        found += page["items"]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert sorted(each["id"] for each in found) == sorted(sent)
    times = [each["created_at"] for each in found]
    assert times == sorted(times, reverse=True)
    assert {each["state"] for each in found} == {"pending"}
