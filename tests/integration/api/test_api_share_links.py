"""Share links: made, listed, revoked; what they show, and what of them is stored."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from chamfer_morph.client import MorphClient
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.server.database.tables import ShareLinkRow
from chamfer_morph.server.quotas import SHARE_LINKS
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import MORPH, Api
from tests.patience import PATIENCE

COMMAND = Path(sys.executable).with_name("morph")


def _headers(secret: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {secret}"}


def test_a_link_is_made_listed_and_revoked(either: Api, run: RunRecord) -> None:
    """It works at once, also without keys; revoked, it shows nothing, and others go on."""
    job = f"/v1/jobs/{either.finished(run)}"
    made = [either.http.post(f"{job}/share-links") for _ in range(2)]
    first, second = (answer.json() for answer in made)
    assert [answer.status_code for answer in made] == [201, 201]
    assert first["path"] == f"/shared/{first['job']}#{first['secret']}"
    listed = either.http.get(f"{job}/share-links").json()
    assert [link["id"] for link in listed] == [first["id"], second["id"]]
    assert "secret" not in listed[0]
    with either.context.engine.connect() as connection:
        rows = str(connection.execute(sa.select(ShareLinkRow)).all())
    assert first["secret"] not in rows, "only a digest is stored"
    for link in (first, second):
        assert either.http.get(job, headers=_headers(link["secret"])).status_code == 200
    assert either.http.delete(made[0].headers["Location"]).status_code == 204
    assert either.http.delete(made[0].headers["Location"]).status_code == 404
    revoked = either.http.get(job, headers=_headers(first["secret"]))
    assert revoked.status_code == 401 and "revoked" in revoked.json()["detail"]
    assert either.http.get(job, headers=_headers(second["secret"])).status_code == 200


def test_a_link_does_not_tell_whose_the_job_is(api: Api) -> None:
    """Neither the name of the key, nor the sweep that the job is of."""
    key = api.http.post("/v1/keys", json={"name": "ann", "scopes": ["admin"]}).json()["secret"]
    sweep = {"sources": [{"shape": "sphere"}], "targets": [{"shape": "star"}]}
    api.http.post("/v1/sweeps", json=sweep, headers=_headers(key))
    (job,) = api.http.get("/v1/jobs", headers=_headers(key)).json()["items"]
    address = f"/v1/jobs/{job['id']}"
    link = api.http.post(f"{address}/share-links", headers=_headers(key)).json()["secret"]
    shown = api.http.get(address, headers=_headers(link)).json()
    assert job["owner"] == "ann" and job["sweep"]
    assert shown == job | {"owner": "", "sweep": None, "queue_position": 0}


def test_links_go_with_the_job_and_with_the_key(api: Api, run: RunRecord) -> None:
    """A deleted job's and a revoked key's links are worth nothing, and no rows are left."""
    root = api.http.post("/v1/keys", json={"name": "root", "scopes": ["admin"]}).json()["secret"]
    ann = api.http.post("/v1/keys", json={"name": "ann"}, headers=_headers(root)).json()["secret"]
    api.http.headers.update(_headers(ann))
    jobs = [f"/v1/jobs/{api.finished(run)}" for _ in range(2)]
    links = [api.http.post(f"{job}/share-links").json()["secret"] for job in jobs]
    assert api.http.delete(jobs[0]).status_code == 204
    api.http.headers.update(_headers(root))
    assert api.http.delete("/v1/keys/ann").status_code == 204
    for job, link in zip(jobs, links, strict=True):
        assert api.http.get(job, headers=_headers(link)).status_code == 401
    assert api.http.get(jobs[1]).status_code == 200
    with api.context.engine.connect() as connection:
        assert connection.execute(sa.select(ShareLinkRow)).all() == []


def test_a_revoked_key_leaves_nothing_that_it_makes_at_that_moment(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An API that has not heard of it yet makes no link and no webhook that would outlive it."""
    root = api.http.post("/v1/keys", json={"name": "root", "scopes": ["admin"]}).json()["secret"]
    ann = api.http.post("/v1/keys", json={"name": "ann"}, headers=_headers(root)).json()["secret"]
    job = api.http.post("/v1/jobs", json=MORPH, headers=_headers(ann)).headers["Location"]
    for store, path, body in (
        (api.context.share_links, f"{job}/share-links", None),
        (api.context.webhooks, "/v1/webhooks", {"url": "https://8.8.8.8/"}),
    ):
        add = store.add

        def add_late(*arguments: Any, add: Callable[..., Any] = add) -> Any:
            api.context.api_keys.remove("ann")
            return add(*arguments)

        monkeypatch.setattr(store, "add", add_late)
        answer = api.http.post(path, json=body, headers=_headers(ann))
        assert answer.status_code == 401 and "revoked" in answer.json()["detail"]
        monkeypatch.undo()
        api.context.api_keys.put("ann", "submit", ann)
    assert api.http.get(f"{job}/share-links", headers=_headers(root)).json() == []
    assert api.http.get("/v1/webhooks", headers=_headers(root)).json() == []


def test_a_link_shows_no_later_job_of_the_same_id(api: Api) -> None:
    """What was removed without the API and submitted again is another job."""
    again = {"Idempotency-Key": "mine"}
    job = api.http.post("/v1/jobs", json=MORPH, headers=again).json()["id"]
    link = api.http.post(f"/v1/jobs/{job}/share-links").json()["secret"]
    api.http.post(f"/v1/jobs/{job}/cancel")
    assert api.context.queue.delete_finished(api.context.queue.get(job))
    api.context.storage.remove_job(job)
    assert api.http.get(f"/v1/jobs/{job}", headers=_headers(link)).status_code == 404
    assert api.http.post("/v1/jobs", json=MORPH, headers=again).json()["id"] == job
    assert api.http.get(f"/v1/jobs/{job}", headers=_headers(link)).status_code == 404
    assert api.http.get(f"/v1/jobs/{job}/share-links").json() == []


def test_a_link_whose_id_is_none(either: Api) -> None:
    """Postgres takes no character 0."""
    job = f"/v1/jobs/{either.submit()['id']}"
    for link in ("%00", "0" * 26, "none"):
        assert either.http.delete(f"{job}/share-links/{link}").status_code == 404


def test_a_job_has_so_many_links(api: Api) -> None:
    """One more is refused until another is revoked."""
    links = f"/v1/jobs/{api.submit()['id']}/share-links"
    made = [api.http.post(links) for _ in range(SHARE_LINKS)]
    assert {answer.status_code for answer in made} == {201}
    assert api.http.post(links).status_code == 429
    assert api.http.delete(made[0].headers["Location"]).status_code == 204
    assert api.http.post(links).status_code == 201


def test_a_link_survives_a_retry(api: Api, run: RunRecord) -> None:
    """The job is computed anew, and is the same job."""
    job = f"/v1/jobs/{api.finished(run)}"
    link = _headers(api.http.post(f"{job}/share-links").json()["secret"])
    assert api.http.post(f"{job}/retry").status_code == 202
    assert api.http.get(job, headers=link).json()["state"] == "queued"


def test_without_keys_a_link_stays_on_this_machine(api: Api) -> None:
    """What keeps others out holds for links, too."""
    job = f"/v1/jobs/{api.submit()['id']}"
    link = _headers(api.http.post(f"{job}/share-links").json()["secret"])
    assert api.http.get(job, headers=link | {"Host": "evil.example"}).status_code == 403
    assert api.http.get(job, headers=link).status_code == 200


def test_the_client_shares(api: Api) -> None:
    """A link's secret is a key that reads the job, and no other thing."""
    job, other = api.submit()["id"], api.submit()["id"]
    server = str(api.http.base_url)
    with MorphClient(server) as client:
        link = client.share(job)
        assert [each.id for each in client.share_links(job)] == [link.id]
        with MorphClient(server, key=link.secret) as visitor:
            assert visitor.job(job).id == job
            for refused in (lambda: visitor.job(other), lambda: visitor.cancel(job)):
                with pytest.raises(ServiceError):
                    refused()
        client.revoke_share_link(job, link.id)
        assert client.share_links(job) == []


def test_the_command_shares(api: Api) -> None:
    """`morph share` prints a URL, lists links, and revokes one or all of them."""
    job = api.submit()["id"]
    server = str(api.http.base_url).rstrip("/")

    def share(*arguments: str) -> Any:
        ran = subprocess.run(
            [COMMAND, "share", job, "--server", server, "--json", *arguments],
            env={name: value for name, value in os.environ.items() if name[:6] != "MORPH_"},
            capture_output=True, text=True, timeout=PATIENCE, check=True,
        )  # fmt: skip
        return json.loads(ran.stdout)

    made = [share() for _ in range(3)]
    assert made[0]["url"] == f"{server}/shared/{job}#{made[0]['secret']}"
    ids = [link["id"] for link in made]
    assert [link["id"] for link in share("--list")["links"]] == ids
    assert share("--revoke-link", ids[0])["revoked"] == ids[:1]
    assert share("--revoke")["revoked"] == ids[1:]
    assert share("--list")["links"] == []
