"""Events: streams that resume, polling that tells the same, many watchers at little cost."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx

from chamfer_morph.server.event_hub import BATCH
from tests.integration.api.conftest import MORPH, Api

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


def test_a_stream_tells_everything_and_ends(either: Api) -> None:
    """What is logged, what comes, each change of state; the last event is the final state."""
    job = either.submit()["id"]
    _log(either, job, "attempt", "frame")
    with either.http.stream("GET", f"/v1/jobs/{job}/events", headers=STREAM) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        events = _events(answer.iter_lines())
        assert [next(events)["type"] for _ in range(3)] == ["attempt", "frame", "state"]
        begun = time.monotonic()
        _log(either, job, "frame")
        assert next(events)["id"] == 3
        assert time.monotonic() - begun < 2, "a stream lags by well under half a second"
        either.http.post(f"/v1/jobs/{job}/cancel")
        last = next(events)
        assert (last["id"], last["data"]) == (3, {"state": "cancelled"})
        assert next(events, None) is None


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
        with httpx.Client(base_url=api.http.base_url, timeout=30) as http:
            answer = http.get(f"/v1/jobs/{job}/events", headers=STREAM)
            seen.append([event["type"] for event in _events(answer.iter_lines())])

    threads = [threading.Thread(target=watch) for _ in range(50)]
    for thread in threads:
        thread.start()
    _wait(lambda: api.context.event_hub.subscribers == 50)
    _log(api, job, "attempt", "frame")
    times = []
    for _ in range(20):
        begun = time.perf_counter()
        assert api.http.get(f"/v1/jobs/{job}").status_code == 200
        times.append(time.perf_counter() - begun)
    api.http.post(f"/v1/jobs/{job}/cancel")
    for thread in threads:
        thread.join(20)
    assert sorted(times)[len(times) // 2] < 1, "others are answered meanwhile"
    assert [events[-1] for events in seen] == ["state"] * 50
    assert all(events.count("frame") == 1 for events in seen)
    _wait(lambda: api.context.event_hub.subscribers == 0)


def test_a_watcher_that_leaves_is_forgotten(api: Api) -> None:
    """A broken connection ends its watch."""
    job = api.submit()["id"]
    url = api.http.base_url
    with socket.create_connection((url.host, url.port or 80), timeout=10) as stream:
        stream.sendall(
            f"GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: {url.host}\r\n"
            "Accept: text/event-stream\r\n\r\n".encode()
        )
        _wait(lambda: api.context.event_hub.subscribers == 1)
    _wait(lambda: api.context.event_hub.subscribers == 0)


def test_too_many_watchers_are_told_to_poll(make_api: Callable[..., Api]) -> None:
    """One stream too many is 429 with a time to retry."""
    api = make_api(watchers=1)
    path = f"/v1/jobs/{api.submit()['id']}/events"
    with api.http.stream("GET", path, headers=STREAM):
        _wait(lambda: api.context.event_hub.subscribers == 1)
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
        _wait(lambda: api.context.event_hub.subscribers == 1)
        assert api.http.get(path, headers=STREAM | headers["root"]).status_code == 429
        with api.http.stream("GET", path, headers=STREAM | headers["ann"]) as other:
            assert other.status_code == 200
    _wait(lambda: api.context.event_hub.subscribers == 0)
    with api.http.stream("GET", path, headers=STREAM | headers["root"]) as again:
        assert again.status_code == 200


def _wait(condition: Callable[[], bool], seconds: float = 10) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)
