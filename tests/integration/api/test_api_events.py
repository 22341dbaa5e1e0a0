"""Events: streams that resume, polling that tells the same, many watchers at little cost."""

from __future__ import annotations

import json
import socket
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import anyio
import httpx
import pytest
from starlette.types import Message

from chamfer_morph.server import event_hub
from chamfer_morph.server.auth import ANONYMOUS
from chamfer_morph.server.event_hub import BATCH, EventHub
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.routes.events import EventStream
from tests.integration.api.conftest import MORPH, Api
from tests.patience import PATIENCE, until

STREAM = {"Accept": "text/event-stream"}


def _events(lines: Iterator[str]) -> Iterator[dict[str, Any]]:
    for line in lines:
        if line.startswith("data: "):
            yield json.loads(line.removeprefix("data: "))


def _log(api: Api, job: str, *types: str) -> None:
    log = api.context.storage.events(job)
    log.path.parent.mkdir(exist_ok=True)
    for kind in types:
        log.append(kind, {"attempt": 1, "frame": 0, "frames": 3, "metrics": {}, "seconds": 1.0})


def test_a_stream_tells_everything_and_ends(either: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is logged, what comes, each change of state; the last event is the final state.

    What comes is told as news, and not only when the stream is kept alive.
    """
    monkeypatch.setattr(event_hub, "KEEP_ALIVE_SECONDS", 2 * PATIENCE)
    job = either.submit()["id"]
    _log(either, job, "attempt", "frame")
    with either.http.stream("GET", f"/v1/jobs/{job}/events", headers=STREAM) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        events = _events(answer.iter_lines())
        assert [next(events)["type"] for _ in range(3)] == ["attempt", "frame", "state"]
        _log(either, job, "frame")
        assert next(events)["id"] == 3
        either.http.post(f"/v1/jobs/{job}/cancel")
        last = next(events)
        assert (last["id"], last["data"]) == (3, {"state": "cancelled"})
        assert next(events, None) is None


def test_a_log_that_cannot_be_read_keeps_no_other_from_being_told(api: Api) -> None:
    """Such as a folder in its place."""
    broken, job = (api.submit()["id"] for _ in range(2))
    _log(api, job, "attempt")
    with ExitStack() as stack:
        streams = [
            stack.enter_context(api.http.stream("GET", f"/v1/jobs/{id}/events", headers=STREAM))
            for id in (broken, job)
        ]
        events = _events(streams[1].iter_lines())
        assert [next(events)["type"] for _ in range(2)] == ["attempt", "state"]
        api.context.storage.events(broken).path.mkdir(parents=True)
        _log(api, job, "frame")
        assert next(events)["type"] == "frame"
        _log(api, job, "frame")
        assert next(events)["type"] == "frame"


def test_a_stream_resumes_behind_the_last_event(api: Api) -> None:
    """Last-Event-ID, `after` and polling skip the same events."""
    job = api.submit()["id"]
    _log(api, job, "attempt", "frame", "frame")
    api.http.post(f"/v1/jobs/{job}/cancel")
    path = f"/v1/jobs/{job}/events"
    resumed = api.http.get(path, headers=STREAM | {"Last-Event-ID": "2"})
    by_query = api.http.get(f"{path}?after=2", headers=STREAM)
    ids = [[event["id"] for event in _events(a.iter_lines())] for a in (resumed, by_query)]
    assert ids == [[3, 3], [3, 3]]  # the event, then the state behind it
    page = api.http.get(f"{path}?after=1&limit=1").json()
    assert [event["id"] for event in page["items"]] == [2]
    assert (page["last_id"], page["state"]) == (2, "cancelled")
    streamed = list(_events(api.http.get(path, headers=STREAM).iter_lines()))
    polled = api.http.get(path).json()["items"]
    assert [event for event in streamed if event["type"] != "state"] == polled


def test_who_comes_late_gets_everything_in_order(api: Api) -> None:
    """More events than are sent at once: each of them arrives, once, before the final state."""
    job = api.submit()["id"]
    count = 2 * BATCH + 88
    _log(api, job, "attempt", *["frame"] * (count - 1))
    api.http.post(f"/v1/jobs/{job}/cancel")
    answer = api.http.get(f"/v1/jobs/{job}/events", headers=STREAM)
    *logged, last = _events(answer.iter_lines())
    assert [event["id"] for event in logged] == list(range(1, count + 1))
    assert (last["id"], last["data"]) == (count, {"state": "cancelled"})


def test_fifty_watchers_share_one_look(api: Api) -> None:
    """All see the same events, and the service forgets the job when the last one leaves."""
    job = api.submit()["id"]
    seen: list[list[str]] = []

    def watch() -> None:
        with httpx.Client(base_url=api.http.base_url, timeout=PATIENCE) as http:
            answer = http.get(f"/v1/jobs/{job}/events", headers=STREAM)
            seen.append([event["type"] for event in _events(answer.iter_lines())])

    threads = [threading.Thread(target=watch) for _ in range(50)]
    for thread in threads:
        thread.start()
    until(lambda: api.context.event_hub.subscribers == 50)
    _log(api, job, "attempt", "frame")
    for _ in range(20):
        assert api.http.get(f"/v1/jobs/{job}").status_code == 200
    assert api.context.event_hub.subscribers == 50, "others are answered meanwhile"
    api.http.post(f"/v1/jobs/{job}/cancel")
    for thread in threads:
        thread.join(PATIENCE)
    assert [events[-1] for events in seen] == ["state"] * 50
    assert all(events.count("frame") == 1 for events in seen)
    until(lambda: api.context.event_hub.subscribers == 0)


def test_a_watcher_that_leaves_is_forgotten(api: Api) -> None:
    """A broken connection ends its watch."""
    job = api.submit()["id"]
    with _connect(api) as stream:
        stream.sendall(_stream_request(api, job))
        until(lambda: api.context.event_hub.subscribers == 1)
    until(lambda: api.context.event_hub.subscribers == 0)


def test_too_many_watchers_are_told_to_poll(make_api: Callable[..., Api]) -> None:
    """One stream too many is 429 with a time to retry."""
    api = make_api(watchers=1)
    path = f"/v1/jobs/{api.submit()['id']}/events"
    with api.http.stream("GET", path, headers=STREAM):
        until(lambda: api.context.event_hub.subscribers == 1)
        refused = api.http.get(path, headers=STREAM)
        assert refused.status_code == 429 and "Retry-After" in refused.headers
        assert api.http.get(path).status_code == 200


def test_a_key_has_its_share_of_the_streams(make_api: Callable[..., Api]) -> None:
    """Whoever follows too much is refused; another key is not, nor the same one afterwards."""
    api = make_api(watchers_per_key=1)
    headers = {}
    for name in ("root", "ann"):
        body = {"name": name, "scopes": ["admin"]}
        made = api.http.post("/v1/keys", json=body, headers=headers.get("root"))
        headers[name] = {"Authorization": f"Bearer {made.json()['secret']}"}
    job = api.http.post("/v1/jobs", json=MORPH, headers=headers["root"]).json()["id"]
    path = f"/v1/jobs/{job}/events"
    with api.http.stream("GET", path, headers=STREAM | headers["root"]):
        until(lambda: api.context.event_hub.subscribers == 1)
        assert api.http.get(path, headers=STREAM | headers["root"]).status_code == 429
        with api.http.stream("GET", path, headers=STREAM | headers["ann"]) as other:
            assert other.status_code == 200
    until(lambda: api.context.event_hub.subscribers == 0)
    with api.http.stream("GET", path, headers=STREAM | headers["root"]) as again:
        assert again.status_code == 200


def _make_key(api: Api, name: str, headers: dict[str, str] | None = None) -> dict[str, str]:
    body = {"name": name, "scopes": ["admin"]}
    made = api.http.post("/v1/keys", json=body, headers=headers)
    return {"Authorization": f"Bearer {made.json()['secret']}"}


def test_share_links_take_from_the_share_of_whose_job_it_is(make_api: Callable[..., Api]) -> None:
    """However many links there are, and whoever has made them."""
    api = make_api(watchers_per_key=2)
    root = _make_key(api, "root")
    ann = _make_key(api, "ann", root)
    job = api.http.post("/v1/jobs", json=MORPH, headers=ann).json()["id"]
    path = f"/v1/jobs/{job}"
    links = [
        api.http.post(f"{path}/share-links", headers=who).json()["secret"]
        for who in (ann, root, root)
    ]
    headers = [STREAM | {"Authorization": f"Bearer {link}"} for link in links]
    with ExitStack() as stack:
        for visitor in headers[:2]:
            stream = api.http.stream("GET", f"{path}/events", headers=visitor)
            assert stack.enter_context(stream).status_code == 200
        refused = api.http.get(f"{path}/events", headers=headers[2])
        assert refused.status_code == 429
        with api.http.stream("GET", f"{path}/events", headers=STREAM | root) as other:
            assert other.status_code == 200, "another key's share is its own"


def test_a_stream_ends_when_its_key_is_revoked(either: Api) -> None:
    """So it is with share links, and with streams from before the first key; others go on."""
    job = either.submit()["id"]
    path = f"/v1/jobs/{job}/events"
    with ExitStack() as stack:

        def follow(headers: dict[str, str] | None = None) -> Iterator[dict[str, Any]]:
            stream = either.http.stream("GET", path, headers=STREAM | (headers or {}))
            answer = stack.enter_context(stream)
            assert answer.status_code == 200
            events = _events(answer.iter_lines())
            assert next(events)["type"] == "state"
            return events

        keyless = follow()
        root = _make_key(either, "root")
        assert next(keyless, None) is None
        ann = _make_key(either, "ann", root)
        link = either.http.post(f"/v1/jobs/{job}/share-links", headers=root).json()
        visitor = {"Authorization": f"Bearer {link['secret']}"}
        streams = [follow(headers) for headers in (root, ann, visitor)]
        either.http.delete("/v1/keys/ann", headers=root)
        _make_key(either, "ann", root)  # another secret under the same name
        assert next(streams[1], None) is None
        either.http.delete(f"/v1/jobs/{job}/share-links/{link['id']}", headers=root)
        assert next(streams[2], None) is None
        either.http.post(f"/v1/jobs/{job}/cancel", headers=root)
        assert next(streams[0])["data"] == {"state": "cancelled"}


def test_a_key_has_its_share_of_fifty_streams_asked_for_at_once(
    make_api: Callable[..., Api],
) -> None:
    """Each is counted as it is let in, and not only once its first event is sent."""
    api = make_api(watchers_per_key=3)
    request = _stream_request(api, api.submit()["id"])
    with ExitStack() as stack:
        streams = [stack.enter_context(_connect(api)) for _ in range(50)]
        for stream in streams:
            stream.sendall(request)
        answers = [stream.recv(12) for stream in streams]
        assert Counter(answers) == {b"HTTP/1.1 200": 3, b"HTTP/1.1 429": 47}
    until(lambda: api.context.event_hub.subscribers == 0)


def test_a_watcher_that_leaves_before_the_first_event_gives_its_place_back(api: Api) -> None:
    """The answer breaks off at its first line; the next stream finds the place free."""
    job = api.context.queue.get(api.submit()["id"])
    assert job is not None

    async def leave_and_come_again() -> None:
        hub = EventHub(
            api.context.queue,
            api.context.storage,
            api.context.authenticator.still_valid,
            limit=1,
            limit_per_key=1,
        )
        stream = EventStream(hub.subscribe(job, ANONYMOUS), after=0)
        with pytest.raises(ProblemError):
            hub.subscribe(job, ANONYMOUS)
        with pytest.raises(BrokenPipeError):
            await stream({"type": "http"}, _nothing_comes, _break_off)
        hub.subscribe(job, ANONYMOUS)
        hub.close()

    anyio.run(leave_and_come_again)


async def _nothing_comes() -> Message:
    await anyio.sleep_forever()
    raise AssertionError


async def _break_off(message: Message) -> None:
    raise BrokenPipeError


def _connect(api: Api) -> socket.socket:
    url = api.http.base_url
    return socket.create_connection((url.host, url.port or 80), timeout=PATIENCE)


def _stream_request(api: Api, job: str) -> bytes:
    return (
        f"GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: {api.http.base_url.host}\r\n"
        "Accept: text/event-stream\r\n\r\n"
    ).encode()
