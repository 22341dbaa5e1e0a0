"""Keys: who needs one, what it allows, what it sees."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from chamfer_morph.server.app import create_app
from chamfer_morph.server.database.api_keys import ApiKeyStore
from chamfer_morph.server.database.callers import Caller, secret_digest
from chamfer_morph.server.database.tables import KeyRow
from tests.integration.api.conftest import MORPH, Api
from tests.patience import PATIENCE


def _key(api: Api, name: str, *scopes: str, by: dict[str, str] | None = None) -> dict[str, str]:
    answer = api.http.post("/v1/keys", json={"name": name, "scopes": list(scopes)}, headers=by)
    assert answer.status_code == 201, answer.text
    return {"Authorization": f"Bearer {answer.json()['secret']}"}


def _status_of_headers(api: Api, method: str, path: str, length: int) -> int:
    """What is answered to headers that announce JSON, of which nothing comes."""
    url = api.http.base_url
    with socket.create_connection((url.host, url.port), timeout=PATIENCE) as connection:
        head = f"{method} {path} HTTP/1.1\r\nHost: {url.host}\r\n"
        head += f"Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
        connection.sendall(head.encode())
        return int(connection.makefile("rb").readline().split()[1])


def test_the_first_key_closes_the_door(either: Api) -> None:
    """Without keys the same machine is free; from the first key on each request needs one."""
    assert either.http.get("/v1/jobs").status_code == 200
    assert either.http.post("/v1/keys", json={"name": "a"}).status_code == 409, "not an admin"
    root = _key(either, "root", "admin")
    missing = either.http.get("/v1/jobs")
    assert missing.status_code == 401 and missing.headers["WWW-Authenticate"] == "Bearer"
    for header in ("Bearer nonsense", "Bearer", "Basic x", "nonsense"):
        wrong = either.http.get("/v1/jobs", headers={"Authorization": header})
        assert wrong.status_code == 401, header
    assert either.http.get("/v1/jobs", headers=root).status_code == 200
    with either.context.engine.connect() as connection:
        row = connection.execute(sa.select(KeyRow)).one()
    assert root["Authorization"].split()[1] not in str(row), "only a digest is stored"
    assert either.http.delete("/v1/keys/root", headers=root).status_code == 204
    assert either.http.get("/v1/jobs").status_code == 200
    assert either.http.get("/v1/jobs", headers=root).status_code == 401


def test_scopes_include_those_below_them(api: Api) -> None:
    """A reader cannot submit, a submitter cannot make keys."""
    root = _key(api, "root", "admin")
    reader, writer = _key(api, "r", "read", by=root), _key(api, "w", "submit", by=root)
    assert api.http.get("/v1/jobs", headers=reader).status_code == 200
    assert api.http.post("/v1/jobs", json=MORPH, headers=reader).status_code == 403
    assert api.http.post("/v1/jobs", json=MORPH, headers=writer).status_code == 202
    for path in ("/v1/keys", "/v1/workers"):
        assert api.http.get(path, headers=writer).status_code == 403
        assert api.http.get(path, headers=root).status_code == 200
    assert api.http.post("/v1/keys", json={"name": "r"}, headers=root).status_code == 409
    assert api.http.delete("/v1/keys/root", headers=root).status_code == 409, "the last admin"
    assert api.http.delete("/v1/keys/none", headers=root).status_code == 404


def test_a_key_sees_its_own_things(api: Api, cube: bytes) -> None:
    """Another key's jobs, sweeps and meshes do not exist for it; an admin sees all."""
    root = _key(api, "root", "admin")
    ann, bob = _key(api, "ann", "submit", by=root), _key(api, "bob", "submit", by=root)
    mesh = api.http.post("/v1/meshes?name=a.obj", content=cube, headers=ann).json()["id"]
    body: dict[str, Any] = MORPH | {"source": {"mesh": mesh}}
    job = api.http.post("/v1/jobs", json=body, headers=ann).json()
    sweep = {"sources": [{"shape": "sphere"}], "targets": [{"shape": "star"}]}
    swept = api.http.post("/v1/sweeps", json=sweep, headers=ann).json()["id"]
    assert job["owner"] == "ann"
    paths = [f"/v1/meshes/{mesh}", f"/v1/jobs/{job['id']}", f"/v1/jobs/{job['id']}/events"]
    for path in [*paths, f"/v1/jobs/{job['id']}/log", f"/v1/sweeps/{swept}"]:
        codes = [api.http.get(path, headers=key).status_code for key in (ann, bob, root)]
        assert codes == [200, 404, 200], path
    assert api.http.post("/v1/jobs", json=body, headers=bob).status_code == 422
    assert api.http.post(f"/v1/jobs/{job['id']}/cancel", headers=bob).status_code == 404
    counts = [len(api.http.get("/v1/jobs", headers=k).json()["items"]) for k in (ann, bob, root)]
    assert counts == [2, 0, 2]
    assert api.http.get("/v1/jobs?owner=ann", headers=bob).status_code == 403
    again = api.http.post("/v1/meshes?name=b.obj", content=cube, headers=bob)
    assert again.status_code == 201, "the bytes are shared, the upload is not"
    assert api.http.delete(f"/v1/meshes/{mesh}", headers=bob).status_code == 204
    assert api.http.get(f"/v1/meshes/{mesh}", headers=ann).status_code == 200
    repeated = {"Idempotency-Key": "1"}
    first = api.http.post("/v1/jobs", json=MORPH, headers=ann | repeated)
    other = api.http.post("/v1/jobs", json=MORPH, headers=bob | repeated)
    assert [first.status_code, other.status_code] == [202, 202], "keys do not share theirs"


def test_an_admin_deletes_its_own_upload_first(api: Api, cube: bytes) -> None:
    """Another key's upload of the same bytes stays, and its file; then that one can be deleted."""
    root = _key(api, "root", "admin")
    ann = _key(api, "ann", "submit", by=root)
    for key in (root, ann):
        mesh = api.http.post("/v1/meshes?name=a.obj", content=cube, headers=key).json()["id"]
    path = f"/v1/meshes/{mesh}"
    assert api.http.delete(path, headers=root).status_code == 204
    assert api.http.get(f"{path}/file", headers=ann).status_code == 200
    body: dict[str, Any] = MORPH | {"source": {"mesh": mesh}}
    job = api.http.post("/v1/jobs", json=body, headers=root).json()["id"]
    assert api.http.delete(path, headers=ann).status_code == 409, "the last upload, still in use"
    api.http.post(f"/v1/jobs/{job}/cancel", headers=root)
    assert api.http.delete(path, headers=root).status_code == 204
    assert api.http.get(path, headers=ann).status_code == 404
    assert api.context.storage.mesh_file(mesh) is None


EVERYWHERE = ["/v1/jobs", "/metrics", "/docs", "/openapi.json", "/", "/v1/nowhere"]


FOREIGN = [
    {"Host": "evil.example"},
    {"Host": "evil.example:8000"},
    {"Host": "127.0.0.1.evil.example"},
    {"Host": ""},
    {"Origin": "http://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://127.0.0.1:1"},
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "cors"},
    {"X-Forwarded-For": "127.0.0.1"},
    {"X-Forwarded-Host": "localhost"},
    {"X-Forwarded-Port": "443"},
    {"X-Forwarded-Prefix": "/morph"},
    {"X-Real-IP": "127.0.0.1"},
    {"Forwarded": "for=127.0.0.1"},
]


def test_without_keys_others_stay_out(api: Api) -> None:
    """No foreign host name, page or proxy gets through, whatever is asked for."""
    for headers in FOREIGN:
        for path in EVERYWHERE:
            refused = api.http.get(path, headers=headers)
            assert refused.status_code == 403 and refused.json()["remedy"], (path, headers)
        assert api.http.post("/v1/jobs", json=MORPH, headers=headers).status_code == 403
        assert api.http.get("/livez", headers=headers).status_code == 200


def test_without_keys_this_machine_is_let_in(api: Api) -> None:
    """By all its names, from its own page, and by a link on another one."""
    port = api.http.base_url.port
    own = f"127.0.0.1:{port}"
    for headers in (
        {"Host": f"localhost:{port}"},
        {"Host": f"[::1]:{port}"},
        {"Host": own, "Origin": f"http://{own}", "Sec-Fetch-Site": "same-origin"},
        {"Sec-Fetch-Site": "none", "Sec-Fetch-Mode": "navigate"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"},
    ):
        assert api.http.get("/v1/jobs", headers=headers).status_code == 200, headers
    posted = {"Origin": f"http://{own}", "Sec-Fetch-Site": "same-origin"}
    assert api.http.post("/v1/jobs", json=MORPH, headers=posted).status_code == 202


def test_with_keys_a_proxy_is_let_in(api: Api) -> None:
    """Whoever has a key may come from anywhere."""
    root = _key(api, "root", "admin")
    headers = root | {"Host": "morph.example", "X-Forwarded-For": "10.0.0.1"}
    assert api.http.get("/v1/jobs", headers=headers).status_code == 200
    assert api.http.get("/metrics", headers=headers).status_code == 200


def test_other_addresses_need_keys(tmp_path: Path) -> None:
    """The API refuses to listen to other machines until there is a key."""
    environment = os.environ | {
        "MORPH_DATA_DIR": str(tmp_path), "MORPH_HOST": "0.0.0.0", "MORPH_PORT": "0",
    }  # fmt: skip

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "chamfer_morph.server", *arguments]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
        )

    for command in ("check", "api", "serve"):
        refused = run(command)
        assert refused.returncode == 2 and "keys add" in refused.stderr, refused.stderr
    made = run("keys", "add", "root", "--scope", "admin")
    assert made.returncode == 0 and made.stdout.startswith("morph_")
    assert run("keys", "add", "root").returncode == 2
    assert '"root"' in run("keys", "list").stdout
    assert run("check").returncode == 0
    assert run("keys", "remove", "root").returncode == 0
    assert run("check").returncode == 2


def test_a_key_from_the_environment_or_a_file(tmp_path: Path) -> None:
    """As a container starts: the key `admin` has the secret it is given, a new one included."""
    file = tmp_path / "admin_key"

    def check(**variables: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "chamfer_morph.server", "check"],
            env=os.environ | {"MORPH_DATA_DIR": str(tmp_path), "MORPH_HOST": "0.0.0.0"} | variables,
            capture_output=True, text=True, timeout=PATIENCE, check=False,
        )  # fmt: skip

    engine = sa.create_engine(f"sqlite:///{tmp_path / 'morph.sqlite'}", poolclass=sa.pool.NullPool)
    store = ApiKeyStore(engine)
    for name, secret in (("MORPH_ADMIN_KEY", "a" * 32), ("MORPH_ADMIN_KEY_FILE", "b" * 32)):
        file.write_text(f"{secret}\n")
        started = check(**{name: str(file) if name.endswith("FILE") else secret})
        assert started.returncode == 0, started.stderr
        digest = secret_digest(secret)
        assert store.callers() == {digest: Caller("admin", "admin", digest=digest)}
    for refused in ({"MORPH_ADMIN_KEY": "short"}, {"MORPH_ADMIN_KEY_FILE": f"{tmp_path}/none"}):
        assert check(**refused).returncode == 2
    assert store.callers().keys() == {secret_digest("b" * 32)}
    made = store.add("ann", ["admin"])
    assert made
    taken = check(MORPH_ADMIN_KEY=made[1])
    assert taken.returncode == 2 and "'ann'" in taken.stderr


def test_strangers_are_refused_before_their_body_is_read(make_api: Callable[..., Api]) -> None:
    """Whatever they send: 401, not a word on the body, and no wait for one that never comes."""
    api = make_api(body_bytes=1000)
    _key(api, "root", "admin")
    operations = [
        (method.upper(), re.sub(r"{\w+}", "0" * 26, path))
        for path, item in create_app(api.settings).openapi()["paths"].items()
        for method in item
        if path.startswith("/v1/")
    ]
    assert ("POST", "/v1/keys") in operations
    json_type = {"Content-Type": "application/json"}
    for method, path in operations:
        for body in (b"{", b"[" * 2000):
            answer = api.http.request(method, path, content=body, headers=json_type)
            assert answer.status_code == 401, (method, path, answer.text)
        for length in (9, 2_000_000_000):
            assert _status_of_headers(api, method, path, length) == 401, (method, path)


def test_a_scope_is_missed_before_the_body_is_read(api: Api) -> None:
    """A key that may not submit learns that, not what is wrong with its JSON."""
    reader = _key(api, "r", "read", by=_key(api, "root", "admin"))
    broken = {"content": b"{", "headers": reader | {"Content-Type": "application/json"}}
    for path in ("/v1/jobs", "/v1/sweeps", "/v1/keys", f"/v1/jobs/{'0' * 26}/exports"):
        assert api.http.post(path, **broken).status_code == 403, path


def test_two_keys_cannot_revoke_each_other(either: Api) -> None:
    """One that can make keys is left, however many are revoked at the same time."""
    store = either.context.api_keys
    for attempt in range(10):
        pair = [f"{name}{attempt}" for name in ("ann", "bob")]
        made = [store.add(name, ["admin"]) for name in pair]
        store.add("carl", ["submit"])
        secrets = [one[1] for one in made if one]

        def revoke(index: int, pair: list[str] = pair, secrets: list[str] = secrets) -> int:
            by = {"Authorization": f"Bearer {secrets[1 - index]}"}
            return either.http.delete(f"/v1/keys/{pair[index]}", headers=by).status_code

        with ThreadPoolExecutor(2) as pool:
            answers = [*pool.map(revoke, range(2))]
        assert answers.count(204) == 1
        assert sum("admin" in key.scopes for key in store.all()) == 1
        store.remove("carl")
        for name in pair:
            store.remove(name)
        either.context.authenticator.invalidate()
