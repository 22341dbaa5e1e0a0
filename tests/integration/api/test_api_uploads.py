"""Uploads: large, slow, cut off, of the wrong type, twice the same, zipped."""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import socket
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from chamfer_morph.server.database.reservations import Reservation
from chamfer_morph.worker.retention.abandoned_uploads import ABANDONED_SECONDS
from chamfer_morph.worker.storage import Storage
from tests.integration.api.conftest import COARSE, MORPH, Api
from tests.patience import PATIENCE, until

BIG = 200 * 2**20


def test_a_mesh_is_stored_and_described(either: Api, cube: bytes) -> None:
    """An upload answers its digest, its report and where it is."""
    answer = either.http.post("/v1/meshes?name=cube.obj", content=cube)
    mesh = answer.json()
    assert answer.status_code == 201, answer.text
    assert mesh["id"] == hashlib.sha256(cube).hexdigest()
    assert mesh["name"] == mesh["report"]["name"] == "cube.obj"
    assert mesh["report"]["watertight"] and abs(mesh["report"]["volume"] - 1000) < 1e-6
    assert either.http.get(answer.headers["Location"]).json() == mesh
    assert either.http.get(f"/v1/meshes/{mesh['id']}/file").content == cube
    assert [item["id"] for item in either.http.get("/v1/meshes").json()["items"]] == [mesh["id"]]
    assert either.http.delete(f"/v1/meshes/{mesh['id']}").status_code == 204
    assert either.http.get(f"/v1/meshes/{mesh['id']}").status_code == 404
    assert either.context.storage.mesh_file(mesh["id"]) is None
    assert not either.uploads()


def test_the_same_file_twice_is_one_mesh(api: Api, cube: bytes) -> None:
    """The second upload answers 200 and the first one's id, as a form too."""
    first = api.http.post("/v1/meshes?name=cube.obj", content=cube)
    again = api.http.post("/v1/meshes?name=again.obj", content=cube)
    form = api.http.post("/v1/meshes", files={"file": ("form.obj", cube)})
    assert [first.status_code, again.status_code, form.status_code] == [201, 200, 200]
    assert first.json() == again.json() == form.json()
    assert len(api.http.get("/v1/meshes").json()["items"]) == 1


def _deleted_before(
    store: Any, name: str, delete: Callable[[], httpx.Response], monkeypatch: pytest.MonkeyPatch
) -> Future[httpx.Response]:
    """Deletes a mesh right before a method is called, which waits for that for a second at most."""
    method, deleted = getattr(store, name), Future[httpx.Response]()

    def call(*arguments: Any, **options: Any) -> Any:
        thread = threading.Thread(target=lambda: deleted.set_result(delete()))
        thread.start()
        thread.join(1)
        return method(*arguments, **options)

    monkeypatch.setattr(store, name, call)
    return deleted


def test_a_mesh_that_a_job_begins_to_use_stays(
    either: Api, cube: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever deletes it at this moment is refused."""
    mesh = either.http.post("/v1/meshes?name=cube.obj", content=cube).json()["id"]
    deleted = _deleted_before(
        either.context.queue,
        "enqueue",
        lambda: either.http.delete(f"/v1/meshes/{mesh}"),
        monkeypatch,
    )
    body = MORPH | {"source": {"mesh": mesh}, "overrides": COARSE}
    assert either.http.post("/v1/jobs", json=body).status_code == 202
    assert deleted.result(PATIENCE).status_code == 409
    assert either.http.get(f"/v1/meshes/{mesh}/file").content == cube


def test_a_mesh_that_another_key_uploads_stays(
    either: Api, cube: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever deletes the same file at this moment deletes their own upload alone."""
    headers: list[dict[str, str]] = []
    for name in ("root", "ann", "bob"):
        body = {"name": name, "scopes": ["admin" if name == "root" else "submit"]}
        made = either.http.post("/v1/keys", json=body, headers=headers[0] if headers else None)
        headers.append({"Authorization": f"Bearer {made.json()['secret']}"})
    _, ann, bob = headers
    upload = {"url": "/v1/meshes?name=cube.obj", "content": cube}
    path = either.http.post(**upload, headers=ann).headers["Location"]
    deleted = _deleted_before(
        either.context.meshes, "add", lambda: either.http.delete(path, headers=ann), monkeypatch
    )
    assert either.http.post(**upload, headers=bob).status_code == 201
    assert deleted.result(PATIENCE).status_code == 204
    assert either.http.get(f"{path}/file", headers=bob).content == cube
    assert either.http.get(path, headers=ann).status_code == 404


def test_a_file_that_is_nobodys_mesh_is_looked_at_anew(either: Api, cube: bytes) -> None:
    """As after a host has deleted a mesh of which another one, with an object store, has a copy."""
    upload = {"url": "/v1/meshes?name=cube.obj", "content": cube}
    mesh = either.http.post(**upload).json()
    either.context.meshes.remove(None, mesh["id"])
    stored = either.context.storage.mesh_file(mesh["id"])
    assert stored is not None
    stored.write_bytes(b"a copy that is not what was sent")
    assert either.http.post(**upload).status_code == 201
    assert either.http.get(f"/v1/meshes/{mesh['id']}/file").content == cube


def test_an_upload_that_ends_stops_no_other_request(
    api: Api, cube: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long the database takes to note that."""
    ending, ended = threading.Event(), threading.Event()
    release = Reservation.release

    def slowly(reservation: Reservation) -> None:
        ending.set()
        ended.wait(PATIENCE)
        release(reservation)

    monkeypatch.setattr(Reservation, "release", slowly)
    answers: list[int] = []
    upload = {"url": "/v1/meshes?name=cube.obj", "content": cube}
    thread = threading.Thread(target=lambda: answers.append(api.http.post(**upload).status_code))
    thread.start()
    try:
        assert ending.wait(PATIENCE)
        assert httpx.get(f"{api.http.base_url}/livez", timeout=PATIENCE).status_code == 200
        assert not answers
    finally:
        ended.set()
        thread.join(PATIENCE)
    assert answers == [201]


def test_an_archive_is_a_mesh(api: Api, cube: bytes) -> None:
    """A ZIP of an OBJ with its materials is one mesh, which has their colours; a bomb is none."""
    archive, bomb = io.BytesIO(), io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("model/cube.obj", b"mtllib cube.mtl\nusemtl red\n" + cube)
        file.writestr("model/cube.mtl", "newmtl red\nKd 0.9 0.1 0.1\n")
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("cube.obj", cube)
        file.writestr("zeros", bytes(300 * 2**20))
    mesh = api.http.post("/v1/meshes?name=cube.zip", content=archive.getvalue()).json()
    assert mesh["report"]["colors"] == "corners" and mesh["report"]["watertight"]
    refused = api.http.post("/v1/meshes?name=bomb.zip", content=bomb.getvalue())
    assert refused.status_code == 422 and "more than 256 MiB" in refused.json()["detail"]


def test_other_types_are_refused(api: Api, cube: bytes) -> None:
    """A file without the suffix of a mesh is 415; a packed one says that it wants unpacking."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("cube.obj", cube)
    text = api.http.post("/v1/meshes?name=notes.txt", content=b"hello")
    nameless = api.http.post("/v1/meshes", content=cube)
    zipped = api.http.post("/v1/meshes", files={"file": ("cube.obj.gz", gzip.compress(cube))})
    disguised = api.http.post("/v1/meshes?name=cube.obj", content=archive.getvalue())
    assert [text.status_code, nameless.status_code, zipped.status_code] == [415, 415, 415]
    assert "Unpack" in zipped.json()["remedy"]
    assert disguised.status_code == 422 and "cube.obj" in disguised.json()["detail"]
    assert not api.uploads() and not api.http.get("/v1/meshes").json()["items"]


def test_an_unusable_mesh_is_refused_with_the_engines_words(api: Api, cube: bytes) -> None:
    """A cube without half of its faces has no inside, and the answer names cause and remedy."""
    broken = b"\n".join(cube.splitlines()[:-6])
    answer = api.http.post("/v1/meshes?name=open.obj", content=broken)
    assert answer.status_code == 422
    assert "open.obj" in answer.json()["detail"] and "Fill Holes" in answer.json()["remedy"]
    assert not api.uploads()


def test_a_misplaced_mesh_is_kept_and_its_job_told_to_fit_it(api: Api, cube: bytes) -> None:
    """What a run can scale is no fault of the mesh; a run that does not scale it is refused."""
    far = cube.replace(b"10", b"900")
    mesh = api.http.post("/v1/meshes?name=far.obj", content=far).json()
    body: dict[str, Any] = {"source": {"mesh": mesh["id"]}, "target": {"shape": "star"}}
    refused = api.http.post("/v1/jobs", json=body | {"overrides": {"sampling.fit": "none"}})
    fitted = api.http.post("/v1/jobs", json=body)
    assert refused.status_code == 422 and "sampling.fit" in refused.json()["remedy"]
    assert fitted.status_code == 202 and fitted.json()["source_name"] == "far.obj"
    assert api.http.delete(f"/v1/meshes/{mesh['id']}").status_code == 409


def test_200_megabytes_come_in_with_bounded_memory(make_api: Callable[..., Api]) -> None:
    """The file is hashed and stored piece by piece; then its content is refused, quickly."""
    api = make_api(inspect_memory_bytes=256 * 2**20)
    process, peak = psutil.Process(), 0
    before = process.memory_info().rss

    def pieces() -> Iterator[bytes]:
        nonlocal peak
        piece = b"# nothing but comments\n" * 4096
        for _ in range(BIG // len(piece)):
            peak = max(peak, process.memory_info().rss)
            yield piece

    answer = api.http.post("/v1/meshes?name=big.obj", content=pieces())
    assert answer.status_code == 422, answer.text
    assert peak - before < 64 * 2**20
    assert not api.uploads()


def test_too_large_is_413(make_api: Callable[..., Api]) -> None:
    """With its length declared or not, as a body or in a form, too much is refused."""
    api = make_api(upload_bytes=1000, body_bytes=1000)
    declared = api.http.post("/v1/meshes?name=a.obj", content=b"x" * 1001)
    streamed = api.http.post("/v1/meshes?name=a.obj", content=iter([b"x" * 600] * 2))
    form = api.http.post("/v1/meshes", files={"file": ("a.obj", b"x" * 1001)})
    body = api.http.post("/v1/jobs", json={"name": "x" * 1001})
    for answer in (declared, streamed, form, body):
        assert answer.status_code == 413 and "Retry-After" in answer.headers
    assert not api.uploads()


def test_a_stalled_upload_is_dropped(make_api: Callable[..., Api]) -> None:
    """Silence for longer than the limit is answered 408, and nothing is left behind."""
    api = make_api(upload_timeout_seconds=0.3)
    with _begin(api, length=1000) as stream:
        stream.sendall(b"v 0 0 0\n")
        status = stream.makefile("rb").readline()
    assert b" 408 " in status
    assert not api.uploads()


def test_a_stalled_body_is_dropped(make_api: Callable[..., Api]) -> None:
    """JSON that stops coming is answered 408 too, wherever it is sent."""
    api = make_api(upload_timeout_seconds=0.3)
    for path in ("/v1/jobs", "/v1/sweeps"):
        with _begin(api, length=1000, path=path, kind="application/json") as stream:
            stream.sendall(b'{"name": ')
            status = stream.makefile("rb").readline()
        assert b" 408 " in status, path


def test_a_cut_upload_leaves_nothing(api: Api) -> None:
    """When the connection breaks, the temporary file goes."""
    with _begin(api, length=4_000_000) as stream:
        stream.sendall(b"v 0 0 0\n" * 200_000)
        until(lambda: len(api.uploads()) == 1)
    until(lambda: not api.uploads())
    assert not api.http.get("/v1/meshes").json()["items"]


def test_broken_forms_are_refused(api: Api, cube: bytes) -> None:
    """A form that is cut, nameless, doubled or has other parts answers 4xx and leaves nothing."""
    kind = {"Content-Type": "multipart/form-data; boundary=b"}
    part = b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.obj"\r\n\r\nv\r\n'
    for body in (b"", b"nonsense", part, b"--b\r\n\r\nx\r\n--b--\r\n", part + part + b"--b--\r\n"):
        assert api.http.post("/v1/meshes", content=body, headers=kind).status_code == 422
    kind = {"Content-Type": "multipart/form-data"}
    assert api.http.post("/v1/meshes", content=part, headers=kind).status_code == 422
    assert api.http.post("/v1/meshes", files={"mesh": ("a.obj", cube)}).status_code == 422
    assert not api.uploads()


def test_a_form_is_bounded(make_api: Callable[..., Api]) -> None:
    """Too many parts, and text that is too long, are refused as too large."""
    api = make_api(body_bytes=1000)
    many = {f"part{i}": "x" for i in range(17)}
    long = {"job": "{}" + " " * 1000}
    file = {"source": ("cube.obj", b"v 0 0 0")}
    for data in (many, long):
        assert api.http.post("/v1/jobs", data=data, files=file).status_code == 413
    as_file = {"job": ("job.json", b"{}" + b" " * 1000)} | file
    assert api.http.post("/v1/jobs", files=as_file).status_code == 413
    assert not api.uploads()


def test_the_json_of_a_form_may_be_a_file(api: Api, cube: bytes) -> None:
    """As `curl -F job=@job.json` sends it."""
    job = b'{"target": {"shape": "star"}, "overrides": {"sampling.fit": "volume"}}'
    form = {"job": ("job.json", job), "source": ("cube.obj", cube)}
    answer = api.http.post("/v1/jobs", files=form)
    assert answer.status_code == 202 and answer.json()["source_name"] == "cube.obj", answer.text


def test_a_job_with_both_files_in_one_form(api: Api, cube: bytes) -> None:
    """Both meshes are kept and the job names them; if one is bad, neither is kept."""
    bad = {"source": ("cube.obj", cube), "target": ("bad.obj", b"nothing")}
    refused = api.http.post("/v1/jobs", data={"job": "{}"}, files=bad)
    assert refused.status_code == 422 and not api.http.get("/v1/meshes").json()["items"]
    good = {"source": ("cube.obj", cube), "target": ("two.obj", cube + b"# another\n")}
    job = '{"frames": 3, "overrides": {"sampling.fit": "volume"}}'
    answer = api.http.post("/v1/jobs", data={"job": job}, files=good)
    assert answer.status_code == 202, answer.text
    assert (answer.json()["source_name"], answer.json()["target_name"]) == ("cube.obj", "two.obj")
    assert len(api.http.get("/v1/meshes").json()["items"]) == 2
    assert not api.uploads()


def test_meshes_come_in_pages(either: Api, cube: bytes) -> None:
    """Cursors go through all of them once, the newest first."""
    names = [f"{i}.obj" for i in range(3)]
    for name in names:
        content = cube + f"# {name}\n".encode()
        assert either.http.post(f"/v1/meshes?name={name}", content=content).status_code == 201
    seen, cursor = [], None
    while True:
        query = {"limit": 2} | ({"cursor": cursor} if cursor else {})
        page = either.http.get("/v1/meshes", params=query).json()
        seen += [item["name"] for item in page["items"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert seen == names[::-1]


def _begin(
    api: Api, length: int, path: str = "/v1/meshes?name=a.obj", kind: str = "model/obj"
) -> socket.socket:
    """A connection with the head of an upload sent."""
    url = api.http.base_url
    stream = socket.create_connection((url.host, url.port or 80), timeout=PATIENCE)
    stream.sendall(
        f"POST {path} HTTP/1.1\r\nHost: {url.host}\r\nContent-Type: {kind}\r\n"
        f"Content-Length: {length}\r\n\r\n".encode()
    )
    return stream


def test_an_api_deletes_what_others_have_left(make_api: Callable[..., Api], tmp_path: Path) -> None:
    """Uploads of one that was killed go when it starts, with no janitor there; new ones stay."""
    uploads = Storage(tmp_path / "data").uploads
    abandoned, growing = uploads / "old.part", uploads / "new.part"
    abandoned.touch()
    growing.touch()
    long_ago = time.time() - ABANDONED_SECONDS - 1
    os.utime(abandoned, (long_ago, long_ago))
    api = make_api(data_dir=tmp_path / "data")
    until(lambda: api.uploads() == [growing], "the abandoned upload to go")
