"""What a key may do with the order of its own jobs: say which is next, and pause them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from chamfer_morph.client import MorphClient
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.worker.queue import JobQueue
from tests.integration.api.conftest import COARSE, MORPH, Api


class User:
    """A key and its jobs.

    Args:
        api: The service.
        secret: The key; empty for none.
    """

    def __init__(self, api: Api, secret: str) -> None:
        self.headers = {"Authorization": f"Bearer {secret}"} if secret else {}
        self._http = api.http
        self.client = MorphClient(str(api.http.base_url), key=secret or None)

    def submit(self, **changes: Any) -> str:
        """Submit a small morph."""
        body = MORPH | {"overrides": COARSE} | changes
        answer = self._http.post("/v1/jobs", json=body, headers=self.headers)
        assert answer.status_code == 202, answer.text
        job: str = answer.json()["id"]
        return job


@pytest.fixture
def users(either: Api) -> Iterator[tuple[User, User, User]]:
    """An admin and two others."""
    keys = [("root", ["admin"]), ("ann", ["submit"]), ("bob", ["submit"])]
    secrets = []
    for name, scopes in keys:
        headers = {"Authorization": f"Bearer {secrets[0]}"} if secrets else {}
        body = {"name": name, "scopes": scopes}
        secrets.append(either.http.post("/v1/keys", json=body, headers=headers).json()["secret"])
    root, ann, bob = (User(either, secret) for secret in secrets)
    with root.client, ann.client, bob.client:
        yield root, ann, bob


def order(queue: JobQueue, *jobs: str) -> list[str]:
    """Queued jobs as they start."""
    return sorted(jobs, key=lambda job: queue.position(job) or 0)


def test_which_is_next(either: Api, users: tuple[User, User, User]) -> None:
    """It takes its owner's first place, stays there whatever is submitted, and harms nobody."""
    _, ann, bob = users
    queue = either.context.queue
    a = [ann.submit() for _ in range(3)]
    b = [bob.submit() for _ in range(3)]
    assert order(queue, *a, *b) == [a[0], b[0], a[1], b[1], a[2], b[2]]
    assert ann.client.put_first(a[2]).queue_position == 0
    assert order(queue, *a, *b) == [a[2], b[0], a[0], b[1], a[1], b[2]]
    ann.client.put_first(a[1])
    urgent = ann.submit(priority=1)
    assert order(queue, *a, urgent) == [a[1], a[2], urgent, a[0]]
    assert order(queue, *b) == b
    with pytest.raises(ServiceError) as caught:
        bob.client.put_first(a[0])
    assert caught.value.status == 404
    ann.client.cancel(a[0])
    with pytest.raises(ServiceError) as caught:
        ann.client.put_first(a[0])
    assert caught.value.status == 409


def test_a_pause(either: Api, users: tuple[User, User, User]) -> None:
    """No job of the key is to be started until its end, whenever it was submitted or retried."""
    root, ann, bob = users
    queue = either.context.queue
    ended = ann.submit()
    ann.client.cancel(ended)
    before = ann.submit()
    others = [bob.submit()]
    assert ann.client.pause_queue().model_dump() == {
        "owner": "ann", "paused": True, "queued": 1, "running": 0
    }  # fmt: skip
    during = [ann.submit(), ann.submit()]
    ann.client.resume(ended)
    mine = [before, *during, ended]
    assert ann.client.queue().queued == 4 and not bob.client.queue().paused
    for job in mine:
        shown = ann.client.job(job)
        assert shown.paused and shown.queue_position is None and shown.state == "queued", job
    assert queue.waiting_since() is not None and queue.unfinished("ann") == 4
    ann.client.put_first(during[1])
    ann.client.cancel(during[0])
    others += [bob.submit() for _ in range(2)]
    assert not ann.client.unpause_queue().paused
    mine = [during[1], ended, before]
    assert order(queue, *mine) == mine
    assert order(queue, *others) == others
    assert queue.position(others[0]) == 0, "who has paused is not first"
    assert not any(ann.client.job(job).paused for job in mine)
    assert root.client.queue().owner == "root"


def test_who_may_pause_whom(either: Api, users: tuple[User, User, User]) -> None:
    """An admin everybody, others themselves; to pause twice is to pause."""
    root, ann, _ = users
    job = ann.submit()
    path = "/v1/queue/pause"
    refused = either.http.post(path, params={"owner": "bob"}, headers=ann.headers)
    assert refused.status_code == 403
    for _ in range(2):
        answer = either.http.post(path, params={"owner": "ann"}, headers=root.headers)
        assert answer.status_code == 200 and answer.json()["paused"]
    assert ann.client.job(job).paused
    for _ in range(2):
        assert not ann.client.unpause_queue().paused
    assert either.context.queue.position(job) == 0


def test_without_keys(make_api: Callable[..., Api]) -> None:
    """Everybody's queue is one."""
    api = make_api()
    job = api.submit()["id"]
    assert api.http.post("/v1/queue/pause").json()["paused"]
    assert api.http.get(f"/v1/jobs/{job}").json()["paused"]
    assert api.context.queue.waiting_since() is None
    assert api.http.post("/v1/queue/unpause").json()["queued"] == 1
    assert not api.http.get(f"/v1/jobs/{job}").json()["paused"]
