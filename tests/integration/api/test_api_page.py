"""The web page as the API serves it: one document, cached and compressed files, a strict policy."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from chamfer_morph.server.http.security_headers import POLICY
from chamfer_morph.server.routes import web_page
from tests.integration.api.conftest import Api


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page as the build leaves it, in a folder of the test's own."""
    folder = tmp_path / "dist"
    (folder / "assets").mkdir(parents=True)
    (folder / "index.html").write_text("<!doctype html><title>morph</title>")
    (folder / "assets" / "index-abc.js").write_text("plain")
    (folder / "assets" / "index-abc.js.gz").write_bytes(b"gzipped")
    (folder / "assets" / "index-abc.js.br").write_bytes(b"brotlied")
    monkeypatch.setattr(web_page, "BUILT", folder)
    return folder


def test_every_address_of_the_page_is_its_document(api: Api, built: Path) -> None:
    """The same document, asked for again each time; a HEAD tells as much."""
    of_jobs = (f"/jobs/{'0' * 26}", f"/shared/{'0' * 26}", "/compare?jobs=a,b")
    for path in ("/", "/new", "/gallery", *of_jobs):
        answer = api.http.get(path)
        assert answer.status_code == 200 and "<title>morph</title>" in answer.text
        assert answer.headers["content-type"] == "text/html; charset=utf-8"
        assert answer.headers["cache-control"] == "no-cache"
        assert api.http.head(path).status_code == 200
    assert api.http.post("/", content=b"").headers["content-type"] == "application/problem+json"


def test_assets_are_kept_for_ever_and_sent_compressed(api: Api, built: Path) -> None:
    """Brotli where the browser takes it, gzip else, plain for whoever takes neither."""
    wanted = {"br, gzip": b"brotlied", "gzip": b"gzipped", "br;q=0, gzip;q=0.5": b"gzipped"}
    for accepted, content in (wanted | {"identity": b"plain"}).items():
        with api.http.stream(
            "GET", "/assets/index-abc.js", headers={"Accept-Encoding": accepted}
        ) as answer:
            assert b"".join(answer.iter_raw()) == content
            assert answer.headers["content-type"].startswith("text/javascript")
            assert "immutable" in answer.headers["cache-control"]
            assert answer.headers["vary"] == "Accept-Encoding"
    (built / "secret").write_text("no")
    for strange in ("none.js", "..%2Fsecret", "%2e%2e", "..%5Csecret", "a%00b"):
        answer = api.http.get(f"/assets/{strange}")
        assert answer.status_code == 404 and answer.json()["detail"]


def test_the_document_announces_what_its_view_will_ask_for(api: Api, built: Path) -> None:
    """Scripts and styles of the view and of what it imports, each once; none that others need."""
    (built / ".vite").mkdir()
    manifest = {
        "src/views/job/job.js": {"file": "assets/job.js", "imports": ["_dom.js"], "css": ["j.css"]},
        "src/viewer/viewer.js": {"file": "assets/viewer.js", "imports": ["_dom.js"]},
        "src/views/jobs/jobs.js": {"file": "assets/jobs.js"},
        "_dom.js": {"file": "assets/dom.js", "imports": ["src/views/job/job.js"]},
    }
    (built / ".vite" / "manifest.json").write_text(json.dumps(manifest))
    announced = api.http.get(f"/jobs/{'0' * 26}").headers["link"].split(", ")
    assert sorted(announced) == [
        "</assets/dom.js>; rel=modulepreload",
        "</assets/job.js>; rel=modulepreload",
        "</assets/viewer.js>; rel=modulepreload",
        "</j.css>; rel=preload; as=style",
    ]
    assert "jobs.js" in api.http.get("/").headers["link"]
    assert "link" not in api.http.get("/new").headers


def test_a_page_that_is_not_built_says_so(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sentence with the remedy, and the API works."""
    monkeypatch.setattr(web_page, "BUILT", tmp_path / "nothing")
    answer = api.http.get("/")
    assert answer.status_code == 404 and "make page" in answer.json()["remedy"]
    assert api.http.get("/v1/jobs").status_code == 200


def test_every_answer_carries_the_policy(
    make_api: Callable[..., Api], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pages, data, errors, and faults of the service; only the documentation has a looser one."""
    api = make_api()

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("on purpose")

    monkeypatch.setattr(type(api.context.queue), "get", fail)
    looser = api.http.get("/docs").headers["content-security-policy"]
    assert "script-src 'self' 'unsafe-inline'" in looser and "default-src 'self'" in looser
    statuses = {
        "/": (200, 404),
        "/v1/jobs": (200,),
        "/v1/none": (404,),
        f"/v1/jobs/{'0' * 26}": (500,),
    }
    for path, status in statuses.items():
        answer = api.http.get(path)
        assert answer.status_code in status
        assert answer.headers["content-security-policy"] == POLICY
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
    assert "unsafe" not in POLICY
