"""Webhooks: a real receiver, real janitors, and kills between a change and its message."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

from chamfer_morph.client import MorphClient
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.schemas import JobState
from chamfer_morph.worker.webhooks.webhooks import Webhooks
from tests.acceptance.conftest import POSTGRES_BY_FAULT_TESTS, Cluster
from tests.integration.api.conftest import serving

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")

MORPH = Path(sys.executable).with_name("morph")
LOOPBACK = "127.0.0.0/8"
EVERY_STATE = [state.value for state in JobState]
TINY = {"method": "joint", "frames": 1, "overrides": {"sampling.points_per_cell_edge": 1}}


class Receiver(ThreadingHTTPServer):
    """Takes messages.

    Attributes:
        received: Headers and body of each request.
        answers: Statuses of the next answers; 204 when there are none left; None never answers.
    """

    daemon_threads = True

    def __init__(self, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.received: list[tuple[dict[str, str], bytes]] = []
        self.answers: list[int | None] = []
        self.ended = threading.Event()

    @property
    def url(self) -> str:
        """Where it takes them."""
        return f"http://127.0.0.1:{self.server_port}/morph?from=test"

    def types(self, job: str | None = None) -> list[str]:
        """Types of the messages about a job, or of all."""
        documents = [json.loads(body) for _, body in self.received]
        return [each["type"] for each in documents if job in (None, each["data"].get("job"))]

    def ids(self) -> list[str]:
        """The id of each message."""
        return [headers["webhook-id"] for headers, _ in self.received]

    def verify(self, secret: str) -> None:
        """See that every message was signed with a secret."""
        key = base64.b64decode(secret.removeprefix("whsec_"))
        for headers, body in self.received:
            signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
            expected = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
            assert headers["webhook-signature"] == f"v1,{expected}"


class _Handler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        headers = {name.lower(): value for name, value in self.headers.items()}
        assert self.path == "/morph?from=test"
        status = self.server.answers.pop(0) if self.server.answers else 204
        self.server.received.append((headers, body))
        if status is None:
            self.server.ended.wait()
            return
        self.send_response(status)
        if 300 <= status < 400:
            self.send_header("Location", self.server.url)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Nobody reads it."""


@contextmanager
def receiving(port: int = 0) -> Iterator[Receiver]:
    """A receiver that answers."""
    with Receiver(port) as receiver:
        threading.Thread(target=receiver.serve_forever, daemon=True).start()
        try:
            yield receiver
        finally:
            receiver.ended.set()
            receiver.shutdown()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    """A receiver that answers."""
    with receiving() as receiver:
        yield receiver


@pytest.fixture
def service(new_cluster, database_url) -> Iterator[tuple[Cluster, MorphClient]]:
    """A cluster that reaches loopback, and a client of its API."""
    cluster = new_cluster(database_url, webhook_networks=LOOPBACK, webhook_retry_seconds="0.2")
    with ExitStack() as stack:
        api = stack.enter_context(serving(cluster.settings.model_copy(update={"port": 0})))
        yield cluster, stack.enter_context(MorphClient(str(api.http.base_url)))


def test_every_change_is_told(service, receiver: Receiver) -> None:
    """In order, signed, to the webhooks that want to know of it, and to nobody else's."""
    cluster, client = service
    webhook = client.create_webhook(receiver.url, states=EVERY_STATE)
    ended = client.create_webhook(receiver.url, secret=webhook.secret)
    Webhooks(cluster.database).add("ann", receiver.url, list(JobState), webhook.secret)
    cluster.start("janitor")
    cluster.worker()
    done = client.submit("sphere", "star", **TINY)
    late = client.submit("sphere", "star", **TINY | {"frames": 500}, timeout_seconds=0.5)
    stopped = client.submit("sphere", "star", **TINY, priority=1000)
    client.cancel(stopped.id)
    expected = {
        done.id: ["job.queued", "job.running", "job.succeeded", "job.succeeded"],
        late.id: ["job.queued", "job.running", "job.timed_out", "job.timed_out"],
        stopped.id: ["job.queued", "job.cancelled", "job.cancelled"],
    }
    cluster.wait_until(lambda: len(receiver.received) >= 11, "all messages")
    for job, types in expected.items():
        assert sorted(receiver.types(job)) == sorted(types)
    assert len(set(receiver.ids())) == len(receiver.ids()) == 11
    receiver.verify(webhook.secret)
    cluster.wait_until(
        lambda: all(each.state == "delivered" for each in client.deliveries(webhook.id)), "the log"
    )
    log = [each for each in client.deliveries(webhook.id) if each.job == done.id]
    assert [each.type for each in log] == ["job.succeeded", "job.running", "job.queued"]
    assert [attempt.status for each in log for attempt in each.attempts] == [204] * 3
    assert all(each.next_attempt_at is None for each in log)
    client.delete_webhook(webhook.id)
    with pytest.raises(ServiceError) as caught:
        client.test_webhook(webhook.id)
    assert caught.value.status == 404
    assert next(each.id for each in client.webhooks()) == ended.id


@POSTGRES_BY_FAULT_TESTS
def test_a_receiver_that_is_away(service) -> None:
    """It has the message when it is back, under one id; refusals and redirects are no delivery."""
    cluster, client = service
    with closing(socket.create_server(("127.0.0.1", 0))) as reserved:
        port = reserved.getsockname()[1]
    webhook = client.create_webhook(f"http://127.0.0.1:{port}/morph?from=test")
    cluster.start("janitor")
    test = client.test_webhook(webhook.id)

    def attempts() -> int:
        return len(next(iter(client.deliveries(webhook.id))).attempts)

    cluster.wait_until(lambda: attempts() >= 2, "two attempts")
    with receiving(port) as receiver:
        receiver.answers = [500, 302]
        cluster.wait_until(lambda: len(receiver.received) >= 3, "the third answer")
        cluster.wait_until(
            lambda: next(iter(client.deliveries(webhook.id))).state == "delivered", "the delivery"
        )
        assert set(receiver.ids()) == {test.id} and len(receiver.received) == 3
        receiver.verify(webhook.secret)
    delivery = next(iter(client.deliveries(webhook.id)))
    assert [attempt.status for attempt in delivery.attempts[-3:]] == [500, 302, 204]
    assert delivery.attempts[0].status is None and delivery.attempts[0].problem
    assert delivery.attempts[-1].problem == ""


@POSTGRES_BY_FAULT_TESTS
def test_it_is_given_up(new_cluster, database_url, receiver: Receiver) -> None:
    """After so many attempts; the log says so, and what was refused by the address is in it."""
    cluster = new_cluster(database_url, webhook_attempts="2", webhook_retry_seconds="0.1")
    webhooks = Webhooks(cluster.database)
    secret = "whsec_" + base64.b64encode(bytes(24)).decode()
    webhook = webhooks.add("", receiver.url, [JobState.FAILED], secret)
    webhooks.add_test(webhook.id)
    cluster.start("janitor")

    def delivery():
        ((_, found),) = webhooks.deliveries(webhook.id, before=None, limit=9)
        return found

    cluster.wait_until(lambda: delivery().state == "failed", "the end of all attempts")
    assert len(delivery().attempts) == 2 and not receiver.received
    assert "127.0.0.1, which is not a public address" in delivery().attempts[1].problem


def test_kills_between_a_change_and_its_message(new_cluster, database_url, receiver) -> None:
    """What an API that is killed at once has queued is told; a message is never half sent."""
    cluster = new_cluster(database_url, webhook_networks=LOOPBACK)
    webhooks = Webhooks(cluster.database)
    secret = "whsec_" + base64.b64encode(bytes(24)).decode()
    webhook = webhooks.add("", receiver.url, [JobState.QUEUED], secret)
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        command = [sys.executable, "-m", "chamfer_morph.server", "api", "--fd"]
        api = subprocess.Popen(
            [*command, str(listener.fileno())],
            env=cluster.environment, pass_fds=(listener.fileno(),),
        )  # fmt: skip
        cluster.processes.append(api)
        address = f"http://127.0.0.1:{listener.getsockname()[1]}/v1/jobs"
        body = {"source": {"shape": "sphere"}, "target": {"shape": "star"}}
        job = httpx.post(address, json=body, timeout=600).json()["id"]
        api.kill()
        api.wait()
    receiver.answers = [None]
    janitor = cluster.start("janitor")
    cluster.wait_until(lambda: len(receiver.received) == 1, "the first attempt")
    os.kill(janitor.pid, signal.SIGKILL)
    janitor.wait()
    with cluster.database.begin() as connection:  # as if the time of the claim were over
        connection.execute(sa.text("update morph_webhook_messages set due_at = 0"))
    cluster.start("janitor")
    cluster.wait_until(lambda: len(receiver.received) == 2, "the second attempt")
    assert receiver.types(job) == ["job.queued"] * 2 and len(set(receiver.ids())) == 1

    def state() -> str:
        ((_, found),) = webhooks.deliveries(webhook.id, before=None, limit=9)
        return found.state

    cluster.wait_until(lambda: state() == "delivered", "the log")


@POSTGRES_BY_FAULT_TESTS
def test_the_command(service, receiver: Receiver) -> None:
    """Create, test, log, list and delete; a test that fails is told and has exit status 1."""
    cluster, client = service
    cluster.start("janitor")

    def morph(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [MORPH, "webhooks", *arguments], capture_output=True, text=True, check=False,
            env=cluster.environment | {"MORPH_SERVER": client._connection.server},
        )  # fmt: skip

    made = morph("create", receiver.url, "--state", "failed")
    assert made.returncode == 0, made.stderr
    webhook, secret = made.stdout.split()
    assert receiver.url in morph("list").stdout and secret not in morph("list").stdout
    tested = morph("test", webhook)
    assert tested.returncode == 0 and "delivered: status 204" in tested.stdout, tested.stdout
    receiver.verify(secret)
    receiver.answers = [500]
    failed = morph("test", webhook)
    assert failed.returncode == 1 and "status 500" in failed.stdout and "again at" in failed.stdout
    assert morph("log", webhook).stdout.count("test") == 2
    assert morph("delete", webhook).returncode == 0
    assert morph("log", webhook).returncode == 2
    refused = morph("create", "http://10.0.0.1/")
    assert refused.returncode == 2 and "not a public address" in refused.stderr
    assert morph("create", receiver.url, "--state", "done").returncode == 2
