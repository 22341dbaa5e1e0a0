"""The client against a small server that fails as told: retries, event streams, downloads."""

import asyncio
import hashlib
import json
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from chamfer_morph.client import AsyncMorphClient, MorphClient, retry
from chamfer_morph.client.errors import ServiceError
from morph_engine.errors import ConfigError, MorphError, ResultError
from tests.patience import PATIENCE, until

JOB_ID = "0" * 26
STATE_PATH = f"/v1/jobs/{JOB_ID}"
EVENTS_PATH = f"{STATE_PATH}/events"
RESULT_PATH = f"{STATE_PATH}/result"
RESULT = bytes(range(256)) * 400
DIGEST = hashlib.sha256(RESULT).hexdigest()


def job(state="queued"):
    """A job as the service shows it."""
    return {
        "id": JOB_ID, "name": "", "state": state, "source": {"shape": "sphere"},
        "target": {"shape": "star"}, "source_name": "sphere", "target_name": "star",
        "method": "joint", "preset": "fast", "seed": 42, "device": "auto", "priority": 100,
        "sweep": None, "owner": "", "created_at": "2026-01-01T00:00:00Z", "started_at": None,
        "finished_at": None, "progress": {"frame": 0, "frames": 4, "attempt": 1},
        "queue_position": None, "outcome": None, "problem": None,
    }  # fmt: skip


def event(number, type_="frame", **data):
    """An event as the service shows it."""
    return {"id": number, "type": type_, "at": "2026-01-01T00:00:00Z", "data": data}


def as_json(document, status=200, **headers):
    """An answer with a JSON body."""
    return status, {"Content-Type": "application/json"} | headers, json.dumps(document).encode()


def problem(status, **headers):
    """An error as the service answers it."""
    return as_json(
        {"title": "Trouble", "status": status, "detail": "It is so", "remedy": "Change it."},
        status,
        **{"Content-Type": "application/problem+json"} | headers,
    )


def stream(*events):
    """An event stream that then breaks off."""
    text = "".join(
        f"id: {each['id']}\nevent: {each['type']}\ndata: {json.dumps(each)}\n\n" for each in events
    )
    return 200, {"Content-Type": "text/event-stream", "Connection": "close"}, text.encode()


HANG_UP = "hang up"


@contextmanager
def serving(*answers):
    """A server that gives these answers one after the other, the last one for ever.

    An answer is a triple, a function of the request, or HANG_UP. Yields the address and the list
    of requests.
    """
    left, requests = list(answers), []

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def answer(self):
            length = int(self.headers.get("Content-Length", 0))
            body = self.rfile.read(length)
            requests.append((self.command, self.path, dict(self.headers), body))
            answer = left.pop(0) if len(left) > 1 else left[0]
            if answer == HANG_UP:
                self.connection.shutdown(socket.SHUT_RDWR)
                self.close_connection = True
                return
            status, headers, content = answer(requests[-1]) if callable(answer) else answer
            self.send_response(status)
            streamed = headers.get("Content-Type") == "text/event-stream"
            lengths = {} if streamed else {"Content-Length": len(content)}
            for name, value in (lengths | headers).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)
            if len(content) < int((lengths | headers).get("Content-Length", 0)):
                self.wfile.flush()
                self.connection.shutdown(socket.SHUT_RDWR)
                self.close_connection = True

        do_GET = do_POST = do_DELETE = answer

        def log_message(self, *args):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", requests
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    """Pauses are there, and short."""
    monkeypatch.setattr(retry, "FIRST_SECONDS", 0.01)
    monkeypatch.setattr(retry, "LONGEST_SECONDS", 0.05)


def test_a_safe_call_survives_a_service_that_comes_back():
    """Lost connections and passing refusals are tried again."""
    answers = HANG_UP, problem(503), (502, {}, b"<html>"), as_json(job())
    with serving(*answers) as (server, requests), MorphClient(server) as client:
        assert client.job(JOB_ID).id == JOB_ID
    assert len(requests) == 4


def test_a_submission_is_repeated_under_the_same_key():
    """However often it is sent, the service can see that it is one; another call is another."""
    answers = HANG_UP, problem(504), as_json(job(), 202)
    with serving(*answers) as (server, requests), MorphClient(server) as client:
        client.submit("sphere", "star")
        client.submit("sphere", "star")
        client.submit("sphere", "star", idempotency_key="mine")
    keys = [headers["Idempotency-Key"] for _, _, headers, _ in requests]
    assert keys[0] == keys[1] == keys[2] != keys[3]
    assert keys[4] == "mine"


def test_an_unsafe_call_is_not_repeated():
    """After a lost connection nobody knows whether it was done."""
    with serving(HANG_UP) as (server, requests), MorphClient(server) as client:
        with pytest.raises(ServiceError, match="no answer"):
            client.retry(JOB_ID)
        with pytest.raises(ServiceError) as caught:
            client.delete(JOB_ID)
    assert len(requests) == 2
    assert caught.value.exit_status == 3


def test_retry_after_is_obeyed(monkeypatch):
    """429 is waited out even by an unsafe call, for it was not done."""
    answers = problem(429, **{"Retry-After": "1"}), as_json(job("cancelled"))
    with serving(*answers) as (server, _), MorphClient(server) as client:
        slept = recorded_sleep(monkeypatch)
        assert client.cancel(JOB_ID).state == "cancelled"
    assert slept == [1.0]


def test_patience_ends():
    """A service that stays away becomes an error that names it, and a long Retry-After too."""
    with serving(problem(503)) as (server, requests), MorphClient(server) as client:
        with pytest.raises(ServiceError, match="It is so") as caught:
            client.job(JOB_ID)
        assert len(requests) == retry.FEW_ATTEMPTS
    assert caught.value.exit_status == 3
    with (
        serving(problem(429, **{"Retry-After": "3600"})) as (server, requests),
        MorphClient(server) as client,
        pytest.raises(ServiceError),
    ):
        client.job(JOB_ID)
    assert len(requests) == 1


def test_whoever_watches_waits_for_the_service(monkeypatch):
    """A service that is away for half a minute ends no watching of hours."""
    away = [problem(503)] * (retry.FEW_ATTEMPTS + 3)
    with serving(*away, as_json(job("running"))) as (server, _), MorphClient(server) as client:
        slept = recorded_sleep(monkeypatch)
        assert client.job(JOB_ID, wait_for_service=True).state == "running"
    assert len(slept) == len(away)


def test_no_service_at_all_says_how_to_start_one():
    """Nobody listens at a port that was just free."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        server = f"http://127.0.0.1:{free.getsockname()[1]}"
    with MorphClient(server) as client, pytest.raises(ServiceError) as caught:
        client.job(JOB_ID)
    assert server in caught.value.cause and "morph serve" in caught.value.remedy
    assert caught.value.exit_status == 3


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (problem(404), ["It is so.", "Change it."]),
        ((403, {"Content-Type": "text/html"}, b"<html>"), ["403", "key"]),
        ((200, {"Content-Type": "text/html"}, b"<html>"), ["not this version", "--server"]),
        ((307, {"Location": "/login"}, b""), ["not this version", "--server"]),
    ],
)
def test_every_answer_becomes_a_cause_and_a_remedy(answer, words):
    """Problem documents are quoted; pages of proxies and strangers are named as such."""
    with (
        serving(answer) as (server, _),
        MorphClient(server) as client,
        pytest.raises(ServiceError) as caught,
    ):
        client.job(JOB_ID)
    assert all(word in str(caught.value) for word in words)


@pytest.mark.parametrize(
    ("server", "key"),
    [
        ("localhost:8000", None),
        ("http://", None),
        ("http://localhost:port", None),
        ("http://[::1", None),
        ("http://x", "a\nb"),
    ],
)
def test_an_address_or_key_that_cannot_be_one_is_refused_at_once(server, key):
    """The user made a slip; nothing is sent."""
    with pytest.raises(ServiceError) as caught:
        MorphClient(server, key=key)
    assert caught.value.exit_status == 2


def test_values_out_of_range_are_refused_before_anything_is_sent():
    """The message names the field."""
    with MorphClient("http://127.0.0.1:9") as client, pytest.raises(MorphError, match="frames"):
        client.submit("sphere", "star", frames=0)


@pytest.mark.parametrize("name", ["../keys/mine", "a?b", "", ".."])
def test_an_id_cannot_lead_elsewhere(name):
    """Whatever is typed as an id stays one segment of the path, or is refused."""
    with serving(problem(404)) as (server, requests), MorphClient(server) as client:
        with pytest.raises(ServiceError) as caught:
            client.delete(name)
    assert caught.value.status == 404
    assert all(path.startswith("/v1/jobs/") and path.count("/") == 3 for _, path, *_ in requests)


def test_the_key_is_sent():
    """As a bearer token."""
    with serving(as_json(job())) as (server, requests), MorphClient(server, key="k") as client:
        client.job(JOB_ID)
    assert requests[0][2]["Authorization"] == "Bearer k"


def test_pages_follow_one_another():
    """The iterator fetches a page when it needs it."""
    pages = (
        as_json({"items": [job(), job()], "next_cursor": "next"}),
        as_json({"items": [job()], "next_cursor": None}),
    )
    with serving(*pages) as (server, requests), MorphClient(server) as client:
        jobs = client.jobs(state="queued")
        next(jobs)
        assert len(requests) == 1
        assert len(list(jobs)) == 2
    assert "cursor=next" in requests[1][1] and "state=queued" in requests[1][1]


def test_a_mesh_that_is_there_is_not_sent_again(tmp_path):
    """Its digest is asked for first; only an unknown mesh travels, whole and under its name."""
    path = tmp_path / "a.obj"
    path.write_bytes(RESULT)
    mesh = {
        "id": DIGEST, "name": "a.obj", "size_bytes": len(RESULT),
        "created_at": "2026-01-01T00:00:00Z", "report": {},
    }  # fmt: skip
    answers = problem(404), HANG_UP, as_json(mesh, 201), as_json(mesh)
    with serving(*answers) as (server, requests), MorphClient(server) as client:
        assert client.upload_mesh(path).id == DIGEST
        assert client.upload_mesh(path).id == DIGEST
    assert [method for method, *_ in requests] == ["GET", "POST", "POST", "GET"]
    assert requests[2][1].endswith("/meshes?name=a.obj") and requests[2][3] == RESULT


def test_events_go_on_after_the_last_one_seen():
    """Lost connections are taken up again by Last-Event-ID; the final state ends the iteration."""
    answers = (
        stream(event(1), event(2)),
        HANG_UP,
        problem(502),
        stream(event(3), event(3, "state", state="succeeded")),
    )
    with serving(*answers) as (server, requests), MorphClient(server) as client:
        seen = [(each.id, each.type) for each in client.events(JOB_ID)]
    assert seen == [(1, "frame"), (2, "frame"), (3, "frame"), (3, "state")]
    assert [headers.get("Last-Event-ID") for _, _, headers, _ in requests] == [None, "2", "2", "2"]


def test_events_of_a_job_that_began_anew_are_followed():
    """After a retry the ids begin again at 1, and so does what is asked for."""
    answers = stream(event(8)), stream(event(1)), stream(event(1, "state", state="failed"))
    with serving(*answers) as (server, requests), MorphClient(server) as client:
        assert [each.id for each in client.events(JOB_ID)] == [8, 1, 1]
    assert requests[2][2]["Last-Event-ID"] == "1"


def test_what_holds_a_stream_open_is_no_event():
    """Comments, a message without data, text beyond ASCII, and a message that is cut off."""
    first, last = event(1, message="\u2028 is no line end"), event(2, "state", state="succeeded")
    text = (
        f": a comment\r\nretry: 1000\n\nid: 1\ndata: {json.dumps(first, ensure_ascii=False)}\n\n"
        f": another\n\ndata:\n\nid: 2\nevent: state\ndata: {json.dumps(last)}"
    )
    status, headers, _ = stream()
    answers = (status, headers, text.encode()), stream(last)
    with serving(*answers) as (server, requests), MorphClient(server) as client:
        seen = [(each.id, each.data) for each in client.events(JOB_ID)]
    assert seen == [(1, first["data"]), (2, last["data"])]
    assert requests[1][2]["Last-Event-ID"] == "1"


def test_a_stream_of_comments_alone_is_waited_for():
    """Whoever waits in a long queue sees no event; streams that are cut now and then go on."""
    status, headers, _ = stream()
    quiet = [(status, headers, b": nothing yet\n\n")] * (retry.MANY_ATTEMPTS + 3)
    last = stream(event(1, "state", state="succeeded"))
    with serving(*quiet, last) as (server, _), MorphClient(server) as client:
        assert [each.id for each in client.events(JOB_ID)] == [1]


@pytest.mark.parametrize("answer", [problem(429), problem(406), as_json({"items": []})])
def test_events_are_polled_where_streams_are_not_to_be_had(answer):
    """Too many watchers, or something in between that knows no streams."""
    pages = (
        as_json({"items": [event(1)], "last_id": 1, "state": "running"}),
        HANG_UP,
        as_json({"items": [event(2)], "last_id": 2, "state": "succeeded"}),
        as_json({"items": [], "last_id": 2, "state": "succeeded"}),
    )
    with serving(answer, *pages) as (server, requests), MorphClient(server) as client:
        assert [each.id for each in client.events(JOB_ID)] == [1, 2]
    assert [path.partition("?")[2] for _, path, _, _ in requests[1:]] == [
        "after=0", "after=1", "after=1", "after=2",
    ]  # fmt: skip


def test_events_of_an_unknown_job_are_an_error():
    """404 is not a reason to wait."""
    with (
        serving(problem(404)) as (server, requests),
        MorphClient(server) as client,
        pytest.raises(ServiceError),
    ):
        list(client.events(JOB_ID))
    assert len(requests) == 1


def test_leaving_the_events_closes_the_stream():
    """No connection is left behind by a loop that ends early; warnings would fail this test."""
    with serving(stream(event(1), event(2))) as (server, _), MorphClient(server) as client:
        for each in client.events(JOB_ID):
            assert each.id == 1
            break


def result(request):
    """The result as a server gives it that knows Range and If-Range."""
    headers = request[2]
    tag = f'"{DIGEST}"'
    if "Range" not in headers or headers.get("If-Range") != tag:
        return 200, {"ETag": tag}, RESULT
    start = int(headers["Range"].removeprefix("bytes=").removesuffix("-"))
    if start >= len(RESULT):
        return problem(416)
    content_range = f"bytes {start}-{len(RESULT) - 1}/{len(RESULT)}"
    return 206, {"ETag": tag, "Content-Range": content_range}, RESULT[start:]


def cut_result(request):
    """As much, cut off in the middle."""
    status, headers, content = result(request)
    return status, headers | {"Content-Length": len(content)}, content[: len(content) // 2]


def test_a_download_goes_on_where_it_broke_off(tmp_path):
    """Each attempt asks for what is missing, and only the whole file appears."""
    path = tmp_path / "result[1].vtkhdf"
    with (
        serving(cut_result, cut_result, result) as (server, requests),
        MorphClient(server) as client,
    ):
        assert client.download(JOB_ID, path) == path
    assert path.read_bytes() == RESULT
    ranges = [headers.get("Range") for _, _, headers, _ in requests]
    assert ranges == [None, f"bytes={len(RESULT) // 2}-", f"bytes={len(RESULT) * 3 // 4}-"]
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("size", [1000, len(RESULT)])
def test_what_an_earlier_command_left_is_completed(tmp_path, size):
    """Some of the file, or all of it but the renaming."""
    (tmp_path / f"r.vtkhdf.{DIGEST}.part").write_bytes(RESULT[:size])
    with serving(result) as (server, requests), MorphClient(server) as client:
        client.download(JOB_ID, tmp_path / "r.vtkhdf")
    assert requests[0][2]["Range"] == f"bytes={size}-"
    assert (tmp_path / "r.vtkhdf").read_bytes() == RESULT
    assert len(list(tmp_path.iterdir())) == 1


def test_what_is_left_of_another_version_is_not_continued(tmp_path):
    """The server sees by If-Range that it is another file, and sends all of this one."""
    (tmp_path / f"r.vtkhdf.{'a' * 64}.part").write_bytes(b"old")
    with serving(result) as (server, _), MorphClient(server) as client:
        client.download(JOB_ID, tmp_path / "r.vtkhdf")
    assert (tmp_path / "r.vtkhdf").read_bytes() == RESULT
    assert len(list(tmp_path.iterdir())) == 1


def test_a_download_that_cannot_be_written_says_why(tmp_path):
    """A folder where the file should be is no fault of the program."""
    (tmp_path / "r.vtkhdf").mkdir()
    with (
        serving(result) as (server, _),
        MorphClient(server) as client,
        pytest.raises(ResultError, match="cannot be written"),
    ):
        client.download(JOB_ID, tmp_path / "r.vtkhdf")


def test_a_damaged_download_is_noticed(tmp_path):
    """The digest tells; neither the file nor its beginning stays, so that the next one is fresh."""
    (tmp_path / f"r.vtkhdf.{DIGEST}.part").write_bytes(b"rubbish")
    with (
        serving(result) as (server, _),
        MorphClient(server) as client,
        pytest.raises(ResultError, match="SHA-256"),
    ):
        client.download(JOB_ID, tmp_path / "r.vtkhdf")
    assert list(tmp_path.iterdir()) == []


def test_the_async_client_does_the_same(tmp_path):
    """One event loop submits, follows and fetches over the same unreliable service."""

    async def use(server):
        async with AsyncMorphClient(server) as client:
            submitted = await client.submit("sphere", "star")
            seen = [each.id async for each in client.events(submitted.id)]
            await client.download(submitted.id, tmp_path / "r.vtkhdf")
            jobs = [each.id async for each in client.jobs()]
        return seen, jobs

    answers = (
        HANG_UP,
        as_json(job(), 202),
        stream(event(1)),
        stream(event(2), event(2, "state", state="succeeded")),
        cut_result,
        result,
        as_json({"items": [job()], "next_cursor": None}),
    )
    with serving(*answers) as (server, _):
        assert asyncio.run(use(server)) == ([1, 2, 2], [JOB_ID])
    assert (tmp_path / "r.vtkhdf").read_bytes() == RESULT


def test_a_wrong_name_is_told_before_a_file_is_sent(tmp_path):
    """Large files do not travel for a typing error."""
    path = tmp_path / "a.obj"
    path.write_bytes(RESULT)
    fast, flow = ({"name": name, "description": ""} for name in ("fast", "flow"))
    with serving(as_json([fast]), as_json([flow])) as (server, requests):
        with MorphClient(server) as client, pytest.raises(ConfigError, match="flwo") as caught:
            client.submit(path, "sphere", method="flwo")
    assert "'flow'" in caught.value.remedy
    assert [path for _, path, *_ in requests] == ["/v1/presets", "/v1/methods"]


def test_the_async_client_streams_an_upload(tmp_path):
    """The file goes out in pieces, with its length said beforehand."""
    path = tmp_path / "a.obj"
    path.write_bytes(RESULT)
    mesh = {
        "id": DIGEST, "name": "a.obj", "size_bytes": len(RESULT),
        "created_at": "2026-01-01T00:00:00Z", "report": {},
    }  # fmt: skip

    async def upload(server):
        async with AsyncMorphClient(server) as client:
            return await client.upload_mesh(path)

    with serving(problem(404), as_json(mesh, 201)) as (server, requests):
        assert asyncio.run(upload(server)).id == DIGEST
    assert requests[1][3] == RESULT and int(requests[1][2]["Content-Length"]) == len(RESULT)


def test_both_clients_have_the_same_methods():
    """Whatever one can do, the other can."""
    names = {name for name in dir(AsyncMorphClient) if not name.startswith("_")}
    assert names == {name for name in dir(MorphClient) if not name.startswith("_")}


def test_the_blocking_client_works_inside_an_event_loop_and_leaves_no_thread():
    """As in a notebook, whose cells run in a loop; closing ends the client's own."""

    async def use(server):
        with MorphClient(server) as client:
            return client.job(JOB_ID).id

    threads = set(threading.enumerate())  # one of which may belong to an earlier test, and end
    with serving(as_json(job())) as (server, _):
        assert asyncio.run(use(server)) == JOB_ID
    # those of the server that answer a connection end by themselves once it is closed
    until(lambda: set(threading.enumerate()) <= threads, "A thread is left.")


def test_errors_of_the_client_need_no_http():
    """Whoever only handles errors does not load what talks to the service."""
    code = "import sys, chamfer_morph.client.errors; sys.exit('httpx' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def recorded_sleep(monkeypatch):
    """Pauses that only say how long they were asked to be."""
    slept = []

    async def sleep(seconds):
        slept.append(round(seconds, 3))

    monkeypatch.setattr(retry, "sleep", sleep)
    return slept


@pytest.mark.parametrize("ending", ["", "; raise ValueError"])
def test_a_client_that_is_not_closed_lets_the_program_end(ending):
    """Also where the program ends with an error that it does not handle."""
    with serving(as_json(job())) as (server, requests):
        program = f"from chamfer_morph.client import MorphClient; c = MorphClient({server!r})"
        command = [sys.executable, "-c", f"{program}; c.job({JOB_ID!r}){ending}"]
        ended = subprocess.run(command, capture_output=True, timeout=PATIENCE, check=False)
    assert ended.returncode == (1 if ending else 0), ended.stderr
    assert requests
