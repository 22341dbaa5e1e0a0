"""Every operation of the contract, asked by those who may not: refused, without a word of data."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import httpx
import pytest

from morph_engine.results.run_record import RunRecord
from tests.integration.api import contract
from tests.integration.api.conftest import MORPH, Api
from tests.patience import PATIENCE, until

OPERATIONS = [
    (operation["operationId"], method.upper(), path)
    for method, path, operation in contract.OPERATIONS
    if path not in ("/livez", "/readyz")
]

SHARED = {
    "getJob", "getEvents", "getResult", "getFrame", "getField", "getSurface", "getThumbnail",
    "getSource", "getTarget", "getSourceMesh", "getTargetMesh", "getColors", "getExport",
    "getExportFile", "getPlayback", "getMetrics", "getConfig",
}  # fmt: skip
"""All that a share link reads; an operation that is new stays closed until it is named here."""

ADMIN = {
    "listKeys", "makeKey", "revokeKey", "listWorkers", "pauseWorker", "unpauseWorker", "metrics",
}  # fmt: skip

BODIES: dict[str, dict[str, Any]] = {"forkJob": {"frame": 0}, "exportJob": {"format": "ply"}}
"""Bodies with which an operation would be allowed."""

METRICS_KEY = "m" * 32

OF_OWNER = ("{job_id}", "{mesh_id}", "{sweep_id}", "{webhook_id}")
"""In addresses of what belongs to a key."""


@dataclass
class House:
    """An API with things of the key `ann` in it, and those who ask for them.

    Attributes:
        http: A client of it.
        ids: What stands in addresses, by its name there.
        keys: Authorization headers by who sends them.
    """

    http: httpx.Client
    ids: dict[str, str]
    keys: dict[str, dict[str, str]]

    def ask(
        self, method: str, path: str, who: str, job_id: str | None = None, **more: Any
    ) -> httpx.Response:
        """Ask for the things of `ann`, or for another job; `more` is what the client takes."""
        ids = self.ids | ({"job_id": job_id} if job_id else {})
        address = re.sub(r"{(\w+)}", lambda name: ids[name[1]], path)
        return self.http.request(method, address, headers=self.keys[who], timeout=PATIENCE, **more)


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory, run: RunRecord) -> Iterator[House]:
    """One for all tests here, which change nothing."""
    from chamfer_morph.worker.settings import Settings
    from tests.integration.api.conftest import CUBE, serving

    folder = tmp_path_factory.mktemp("access")
    settings = Settings(
        _env_file=None, data_dir=folder, port=0, host="127.0.0.1", metrics_key=METRICS_KEY
    )
    with serving(settings) as api:
        yield _furnished(api, run, CUBE)


def _furnished(api: Api, run: RunRecord, mesh: str) -> House:
    keys = {"nobody": {}, "prometheus": {"Authorization": f"Bearer {METRICS_KEY}"}}

    def make_key(name: str, *scopes: str) -> dict[str, str]:
        body = {"name": name, "scopes": list(scopes)}
        made = api.http.post("/v1/keys", json=body, headers=keys.get("root"))
        return {"Authorization": f"Bearer {made.json()['secret']}"}

    keys["root"] = make_key("root", "admin")
    for name, scope in (
        ("ann", "submit"),
        ("bob", "submit"),
        ("reader", "read"),
        ("gone", "submit"),
    ):
        keys[name] = make_key(name, scope)

    def post(path: str, **more: Any) -> dict[str, Any]:
        answer = api.http.post(path, headers=keys["ann"], **more)
        assert answer.status_code < 300, answer.text
        found: dict[str, Any] = answer.json()
        return found

    api.http.headers.update(keys["ann"])
    ids = {"job_id": api.finished(run), "other": post("/v1/jobs", json=MORPH)["id"]}
    del api.http.headers["Authorization"]
    job = f"/v1/jobs/{ids['job_id']}"
    ids["export_id"] = post(f"{job}/exports", json={"format": "ply"})["id"]
    export = partial(post, f"{job}/exports", json={"format": "ply"})
    until(lambda: export()["state"] == "ready")
    ids["mesh_id"] = post("/v1/meshes?name=a.obj", content=mesh)["id"]
    sweep = {"sources": [{"shape": "sphere"}], "targets": [{"shape": "star"}]}
    ids["sweep_id"] = post("/v1/sweeps", json=sweep)["id"]
    webhook = {"url": "https://example.com/morph"}
    ids["webhook_id"] = post("/v1/webhooks", json=webhook)["id"]
    link = post(f"{job}/share-links")
    keys["link"] = {"Authorization": f"Bearer {link['secret']}"}
    revoked = post(f"{job}/share-links")
    keys["revoked link"] = {"Authorization": f"Bearer {revoked['secret']}"}
    api.http.delete(f"{job}/share-links/{revoked['id']}", headers=keys["ann"])
    api.http.delete("/v1/keys/gone", headers=keys["root"])
    ids |= {"link_id": link["id"], "index": "0", "field": "displacement", "name": "fast"}
    ids |= {"shape": "sphere", "worker_id": "none-slot9"}
    return House(api.http, ids, keys)


def check_refused(answer: httpx.Response, *statuses: int) -> None:
    """A problem with one of these statuses, and nothing else."""
    assert answer.status_code in statuses, answer.text[:300]
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(("name", "method", "path"), OPERATIONS)
@pytest.mark.parametrize("who", ["nobody", "gone", "revoked link"])
def test_without_a_valid_key(house: House, who: str, name: str, method: str, path: str) -> None:
    """No key, a revoked one, a revoked link: 401 for everything."""
    check_refused(house.ask(method, path, who), 401)


@pytest.mark.parametrize(("name", "method", "path"), OPERATIONS)
def test_with_too_narrow_a_key(house: House, name: str, method: str, path: str) -> None:
    """What changes something is not for a key that reads, nor what an admin does for another."""
    if name in ADMIN:
        check_refused(house.ask(method, path, "ann"), 403)
    if name in ADMIN or method != "GET":
        check_refused(house.ask(method, path, "reader"), 403)


@pytest.mark.parametrize(
    ("name", "method", "path"), [o for o in OPERATIONS if any(part in o[2] for part in OF_OWNER)]
)
def test_with_another_key(house: House, name: str, method: str, path: str) -> None:
    """What belongs to a key is not there for another, whatever else is wrong with the request."""
    check_refused(house.ask(method, path, "bob"), 404)
    if method == "POST":
        check_refused(house.ask(method, path, "bob", json=BODIES.get(name, {})), 404)


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/v1/jobs"),
        ("GET", "/v1/queue"),
        ("POST", "/v1/queue/pause"),
        ("POST", "/v1/queue/unpause"),
    ],
)
def test_what_is_asked_for_by_owner(house: House, method: str, path: str) -> None:
    """Another key's is forbidden, and so is that of a key that is not there."""
    for owner in ("ann", "root", "nobody-at-all"):
        check_refused(house.ask(method, path, "bob", params={"owner": owner}), 403)


def test_lists_have_nothing_of_another_key(house: House) -> None:
    """Whichever filter is asked for."""
    assert house.ask("GET", "/v1/jobs", "bob").json()["items"] == []
    assert house.ask("GET", "/v1/meshes", "bob").json()["items"] == []
    assert house.ask("GET", "/v1/webhooks", "bob").json() == []
    sweep = {"sweep": house.ids["sweep_id"]}
    assert house.ask("GET", "/v1/jobs", "bob", params=sweep).json()["items"] == []
    assert house.ask("GET", "/v1/jobs", "ann", params=sweep).json()["items"] != []


@pytest.mark.parametrize("role", ["source", "target"])
def test_the_mesh_of_another_key_as_an_end(house: House, role: str) -> None:
    """It is as unknown as one that was never uploaded: here and in what is submitted."""
    particles = "/v1/shapes/{shape}/particles"
    for mesh in (house.ids["mesh_id"], "0" * 64):
        answers = [
            house.ask("GET", particles, "bob", params={role: mesh}),
            house.ask("POST", "/v1/jobs", "bob", json=MORPH | {role: {"mesh": mesh}}),
        ]
        for answer in answers:
            check_refused(answer, 422)
            assert answer.json()["detail"] == f"There is no mesh {mesh}."
    assert house.ask("GET", particles, "ann", params={role: house.ids["mesh_id"]}).is_success


@pytest.mark.parametrize(("name", "method", "path"), OPERATIONS)
def test_with_a_share_link(house: House, name: str, method: str, path: str) -> None:
    """A link reads what is of its job; of another there is nothing, and all else is forbidden."""
    if name not in SHARED:
        check_refused(house.ask(method, path, "link"), 403)
        return
    answer = house.ask(method, path, "link")
    assert answer.status_code == 200, answer.text[:300]
    check_refused(house.ask(method, path, "link", job_id=house.ids["other"]), 404)


@pytest.mark.parametrize(("name", "method", "path"), OPERATIONS)
def test_with_the_key_of_the_figures(house: House, name: str, method: str, path: str) -> None:
    """It opens them and nothing else."""
    answer = house.ask(method, path, "prometheus")
    if name == "metrics":
        assert answer.status_code == 200 and "morph_jobs" in answer.text
    else:
        check_refused(answer, 401)


def test_the_lists_here_are_of_the_contract() -> None:
    """Each name stands for an operation."""
    assert SHARED | ADMIN <= {name for name, _, _ in OPERATIONS}
