"""Hosts that share a database and an object store, and no folder."""

from __future__ import annotations

import hashlib
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import psycopg
import pytest
import sqlalchemy as sa

from chamfer_morph.client import MorphClient
from chamfer_morph.schemas import JobState
from tests.acceptance.conftest import FRAMES, Cluster
from tests.integration.api.conftest import serving
from tests.object_store import BUCKET, Link, s3_server
from tests.patience import until

pytestmark = pytest.mark.faults

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""The result is the only file of a job that begins like this."""

PATIENCE = 120.0
"""How long a job may take to its result [s]."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, int]]:
    """Address of an S3 server."""
    with s3_server(tmp_path_factory.mktemp("s3") / "log") as address:
        yield address


@pytest.fixture
def new_host(
    new_cluster: Callable[..., Cluster],
    store: tuple[str, int],
    postgres: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Callable[..., Cluster]]:
    """Makes a host with a folder of its own; its links to store and database may be others."""
    name = f"hosts_{tmp_path.name}".replace("-", "_").lower()
    with psycopg.connect(postgres, autocommit=True) as connection:
        connection.execute(f'drop database if exists "{name}" with (force)')
        connection.execute(f'create database "{name}"')
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "id")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_REGION", "us-east-1")

    def make(link: Link | None = None, *, database: Link | None = None, **settings: str) -> Cluster:
        host, port = ("127.0.0.1", link.port) if link else store
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        url = sa.make_url(postgres).set(database=name)
        if database:
            url = url.set(host="127.0.0.1", port=database.port)
            url = url.update_query_dict({"sslmode": "disable"})  # so that the link can read it
        address = f"s3://{BUCKET}/{tmp_path.name}"
        return new_cluster(
            url.render_as_string(hide_password=False), object_store=address, **settings
        )

    yield make
    with psycopg.connect(postgres, autocommit=True) as connection:
        connection.execute(f'drop database "{name}" with (force)')


@pytest.fixture
def link(store: tuple[str, int]) -> Iterator[Link]:
    """A link to the store that can be cut."""
    link = Link(store)
    yield link
    link.close()


def test_job_of_a_lost_host(
    new_host: Callable[..., Cluster], undisturbed: np.ndarray, tmp_path: Path
) -> None:
    """Another host goes on with it from what was published, and the result is the same."""
    first, second, reader = new_host(), new_host(), new_host()
    worker = first.worker(0)
    job = reader.submit()
    reader.wait_for_frame(job, FRAMES // 3)
    first.engine(worker).kill()
    worker.kill()
    second.start("janitor")
    second.worker(1)
    reader.require_sound(job, undisturbed, kills=3)
    resumed = [
        event.data["resumed_frames"]
        for event in reader.storage.events(job).read()
        if event.type == "attempt"
    ]
    assert len(resumed) == 2 and resumed[1] >= FRAMES // 3
    assert not [*tmp_path.glob("data1/*slot1/jobs/*")], "what is published stays on no worker"


def test_parts_of_a_result_come_from_the_store(new_host: Callable[..., Cluster]) -> None:
    """Range and whole downloads of a job of another host, of which this one keeps no file."""
    first, second = new_host(), new_host()
    first.worker(0)
    with serving(second.settings.model_copy(update={"port": 0})) as api:
        with MorphClient(str(api.http.base_url)) as client:
            run = {"method": "joint", "frames": 3}
            job = client.submit("sphere", "star", **run).id
        outcome = first.wait_for_state(job, JobState.SUCCEEDED).outcome
        assert outcome is not None
        address, size = f"/v1/jobs/{job}/result", outcome.size_bytes
        whole = api.http.get(address)
        assert hashlib.sha256(whole.content).hexdigest() == outcome.sha256
        tag = whole.headers["ETag"]
        for asked, begin, end in (
            ("bytes=0-7", 0, 8),
            ("bytes=1000-", 1000, size),
            ("bytes=-100", size - 100, size),
            (f"bytes={size - 5}-{size + 5}", size - 5, size),
        ):
            part = api.http.get(address, headers={"Range": asked, "If-Range": tag})
            assert part.status_code == 206
            assert part.headers["Content-Range"] == f"bytes {begin}-{end - 1}/{size}"
            assert part.content == whole.content[begin:end]
        for headers, status in (
            ({"Range": f"bytes={size}-"}, 416),
            ({"Range": "bytes=0-7", "If-Range": '"another"'}, 200),
            ({"Range": "bytes=0-7,9-10"}, 200),
            ({"If-None-Match": tag}, 304),
        ):
            assert api.http.get(address, headers=headers).status_code == status
        path = api.context.storage.result_path(job)
        assert not path.exists()
        api.http.get(f"/v1/jobs/{job}/frames/0").raise_for_status()  # which fetches it
        assert path.stat().st_size == size
        here = api.http.get(address, headers={"Range": "bytes=0-7"})
        assert here.status_code == 206 and here.content == HDF5_SIGNATURE


def test_a_fork(new_host: Callable[..., Cluster]) -> None:
    """One host computes a job, another forks it, a third goes on."""
    first, second, third = new_host(), new_host(), new_host()
    worker = first.worker(0)
    with serving(second.settings.model_copy(update={"port": 0})) as api:
        run = {"method": "joint", "frames": 3, "overrides": {"sampling.points_per_cell_edge": 1}}
        with MorphClient(str(api.http.base_url)) as client:
            original = client.submit("sphere", "star", **run, states_every=2)
            first.wait_for_state(original.id, JobState.SUCCEEDED)
            worker.terminate()
            worker.wait()
            fork = client.fork(original.id, 1)
            client.delete(original.id)
            third.worker(1)
            record = third.wait_for_state(fork.id, JobState.SUCCEEDED, JobState.FAILED)
            assert record.state is JobState.SUCCEEDED, record.problem
            assert [row["frame"] for row in client.metrics(fork.id)] == [0, 1, 2]


@pytest.mark.parametrize(
    ("trouble", "seconds"), [(Link.cut, 5.0), (Link.cut, 60.0), (Link.fail, 20.0)]
)
def test_link_that_is_cut_or_a_store_that_fails(
    new_host: Callable[..., Cluster],
    link: Link,
    undisturbed: np.ndarray,
    trouble: Callable[[Link], None],
    seconds: float,
) -> None:
    """The engine goes on while the store is away, or answers with errors; all is there after it."""
    reader, host = new_host(), new_host(link)
    host.worker(0)
    job = reader.submit()
    reader.wait_for_frame(job, 3)
    trouble(link)
    time.sleep(seconds)
    assert reader.job(job).state is JobState.RUNNING
    assert bool(link.refused) == (trouble is Link.fail)
    link.mend()
    reader.require_sound(job, undisturbed, kills=0)


@pytest.mark.parametrize("seconds", [5.0, 60.0])
def test_link_that_is_cut_in_the_middle_of_the_result(
    new_host: Callable[..., Cluster], link: Link, undisturbed: np.ndarray, seconds: float
) -> None:
    """The result is sent again once the store is back."""
    reader, host = new_host(), new_host(link)
    link.cut_at = HDF5_SIGNATURE
    host.worker(0)
    job = reader.submit()
    assert link.was_cut.wait(PATIENCE)
    time.sleep(seconds)
    assert reader.job(job).state is JobState.RUNNING
    link.mend()
    reader.require_sound(job, undisturbed, kills=0)


def test_worker_that_is_killed_in_the_middle_of_the_result(
    new_host: Callable[..., Cluster], link: Link, undisturbed: np.ndarray
) -> None:
    """Another host writes it, from the frames that were published."""
    reader, first, second = new_host(), new_host(link), new_host()
    link.cut_at = HDF5_SIGNATURE
    worker = first.worker(0)
    job = reader.submit()
    assert link.was_cut.wait(PATIENCE)
    worker.kill()
    second.start("janitor")
    second.worker(1)
    reader.require_sound(job, undisturbed, kills=1)


def test_store_that_is_slow(
    new_host: Callable[..., Cluster], link: Link, undisturbed: np.ndarray
) -> None:
    """Whose every answer takes a second: the job ends, and the worker keeps it."""
    reader, host = new_host(), new_host(link)
    link.delay = 0.5  # there and back
    host.worker(0)
    job = reader.submit()
    reader.require_sound(job, undisturbed, kills=0)


def test_the_api_while_the_store_is_away(new_host: Callable[..., Cluster], link: Link) -> None:
    """Jobs are listed, shown, followed, cancelled; what needs their files says what is missing."""
    near, host = new_host(), new_host(link)  # the last one tells where the API looks
    with serving(host.settings.model_copy(update={"port": 0})) as api:
        job = near.submit()
        assert api.http.get("/v1/jobs").status_code == 200
        until(lambda: api.http.get("/readyz").json() == {"status": "ok"})
        link.cut()
        (shown,) = api.http.get("/v1/jobs").json()["items"]
        assert shown["id"] == job and shown["state"] == "queued"
        assert api.http.get(f"/v1/jobs/{job}").json()["state"] == "queued"
        cancelled = api.http.post(f"/v1/jobs/{job}/cancel")
        assert cancelled.status_code == 202 and cancelled.json()["state"] == "cancelled"
        other = near.submit()
        accept = {"Accept": "text/event-stream"}
        with api.http.stream("GET", f"/v1/jobs/{other}/events", headers=accept) as stream:
            lines = (line for line in stream.iter_lines() if line.startswith("data: "))
            assert "queued" in next(lines)
            near.queue.cancel(other)
            assert "cancelled" in next(lines)
        answer = api.http.get(f"/v1/jobs/{job}/frames/0")
        assert answer.status_code == 503 and "object store" in answer.json()["detail"]
        until(lambda: api.http.get("/readyz").json()["status"] == "reading")
        ready = api.http.get("/readyz")
        assert ready.status_code == 200 and "object store" in ready.json()["detail"]
        link.mend()
        until(lambda: api.http.get("/readyz").json() == {"status": "ok"})


@pytest.mark.parametrize("of", ["a frame", "the result"])
def test_link_that_stays_cut(new_host: Callable[..., Cluster], link: Link, of: str) -> None:
    """A job whose files nobody can have fails, and says why; resumed, it ends where it was."""
    reader, host = new_host(), new_host(link, object_store_seconds="1")
    if of == "the result":
        link.cut_at = HDF5_SIGNATURE
    host.worker(0)
    job = reader.submit()
    if of == "a frame":
        reader.wait_for_frame(job, 3)
        link.cut()
    record = reader.wait_for_state(job, JobState.FAILED)
    assert record.problem is not None
    assert record.problem.kind == "resources"
    assert "object store does not answer" in record.problem.cause
    link.mend()
    reader.queue.resume(job)
    reader.wait_for_state(job, JobState.SUCCEEDED)
    assert sorted(reader.frames(job)) == [*range(FRAMES)]


def test_two_workers_that_believe_to_own_a_job(
    new_host: Callable[..., Cluster], link: Link, undisturbed: np.ndarray
) -> None:
    """A worker that was cut off publishes nothing over what its successor has published."""
    reader, cut_off, successor = new_host(), new_host(link), new_host()
    worker = cut_off.worker(0)
    job = reader.submit()
    reader.wait_for_frame(job, 3)
    link.cut()
    worker.send_signal(signal.SIGSTOP)  # it is still there, and knows nothing
    reader.queue.cancel(job)
    reader.wait_for_state(job, JobState.CANCELLED)
    reader.queue.retry(job)
    successor.worker(1)
    reader.wait_for_frame(job, FRAMES // 2)
    link.mend()
    worker.send_signal(signal.SIGCONT)
    reader.require_sound(job, undisturbed, kills=0)


@pytest.mark.parametrize(
    ("trouble", "seconds"),
    [
        (Link.cut, 5.0),
        (Link.silence, 40.0),  # longer than Postgres keeps the session of a silent worker
        (partial(Link.silence, there=False), 40.0),
    ],
    ids=["cut", "silent", "no answers"],
)
def test_link_to_the_database(
    new_host: Callable[..., Cluster],
    postgres: str,
    undisturbed: np.ndarray,
    trouble: Callable[[Link], None],
    seconds: float,
) -> None:
    """Cut, or silent one way or both: the job ends once, here or at another host."""
    url = sa.make_url(postgres)
    link = Link((url.host or "127.0.0.1", url.port or 5432))
    reader, host, other = new_host(), new_host(database=link), new_host()
    host.worker(0)
    job = reader.submit()
    reader.wait_for_frame(job, 3)
    trouble(link)
    other.start("janitor")
    other.worker(1)
    time.sleep(seconds)
    link.mend()
    reader.require_sound(job, undisturbed, kills=1)
    link.close()


def test_host_that_vanishes_within_a_transaction(
    new_host: Callable[..., Cluster], postgres: str, undisturbed: np.ndarray
) -> None:
    """What it has locked is free soon, although nobody tells Postgres that the host is gone."""
    url = sa.make_url(postgres)
    link = Link((url.host or "127.0.0.1", url.port or 5432))
    reader, host, other = new_host(), new_host(database=link), new_host()
    host.worker(0)
    job = reader.submit()
    reader.wait_for_frame(job, 3)
    while not _holds_a_beat(reader.database):
        link.mend()
        link.silent_at = b"COMMIT"
        reader.wait_until(lambda: not link.silent_at, "a transaction of the worker")
    other.start("janitor")
    other.worker(1)
    reader.require_sound(job, undisturbed, kills=1)
    link.close()


def _holds_a_beat(database: sa.Engine) -> bool:
    """Whether a transaction that waits for its client has written the sign of life of a job."""
    query = sa.text(
        "select count(*) from pg_locks join pg_stat_activity as session using (pid) "
        "where state = 'idle in transaction' and mode = 'RowExclusiveLock' "
        "and relation = 'dbos.workflow_events'::regclass"
    )
    with database.connect() as connection:
        return bool(connection.execute(query).scalar_one())
