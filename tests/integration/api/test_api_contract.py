"""The contract: committed, true, and one shape for every error."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from chamfer_morph.schemas import ProblemDocument
from chamfer_morph.server.app import create_app
from chamfer_morph.server.http.openapi import text
from chamfer_morph.server.routes import health
from chamfer_morph.worker.settings import Settings
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import Api
from tests.integration.api.contract import CONTRACT, OPERATIONS, ROOT
from tests.patience import PATIENCE, until

SAMPLES = {
    "job_id": "0" * 26, "sweep_id": "0" * 26, "mesh_id": "0" * 64, "worker_id": "none-slot9",
    "export_id": "0" * 26, "webhook_id": "0" * 26, "link_id": "0" * 26,
    "name": "none", "index": "0", "shape": "sphere", "field": "speed",
}  # fmt: skip


def test_the_committed_contract_is_the_apps() -> None:
    """`python -m chamfer_morph.server openapi > openapi/openapi.json` brings it up to date."""
    assert json.loads(text(create_app(Settings(_env_file=None)))) == CONTRACT


def test_every_operation_is_described() -> None:
    """An id, a summary, a description and a shape for each error."""
    names = [operation["operationId"] for _, _, operation in OPERATIONS]
    assert len(set(names)) == len(names)
    for method, path, operation in OPERATIONS:
        assert operation["summary"] and operation["description"], (method, path)
        errors = {code: body for code, body in operation["responses"].items() if code >= "400"}
        assert "500" in errors
        for code, body in errors.items():
            assert body == {"$ref": f"#/components/responses/{code}"}
    for answer in CONTRACT["components"]["responses"].values():
        assert list(answer["content"]) == ["application/problem+json"]


def test_every_operation_is_documented() -> None:
    """docs/api.md names each address."""
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    for method, path, _ in OPERATIONS:
        assert f"{method.upper()} {path.removeprefix('/v1')}" in page, (method, path)


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        (method, path, example["value"])
        for method, path, operation in OPERATIONS
        for example in operation.get("requestBody", {})
        .get("content", {})
        .get("application/json", {})
        .get("examples", {})
        .values()
    ],
)
def test_the_examples_work(api: Api, run: RunRecord, method: str, path: str, body: Any) -> None:
    """Each example of the contract is accepted as it stands."""
    if "{job_id}" in path:
        path = path.format(job_id=api.finished(run))
    answer = api.http.request(method, path, json=body)
    assert answer.status_code in (201, 202), answer.text


@pytest.mark.parametrize(("method", "path"), [(m, p) for m, p, _ in OPERATIONS])
def test_every_error_has_one_shape(api: Api, method: str, path: str) -> None:
    """Unknown ids, wrong methods, broken bodies and bad queries answer one kind of document."""
    sampled = re.sub(r"{(\w+)}", lambda name: SAMPLES[name[1]], path)
    answers = [
        api.http.request("PATCH", sampled),
        api.http.request(method, sampled + "/nowhere"),
        api.http.request(method, sampled, headers={"Authorization": "Bearer wrong"}),
        api.http.request(method, sampled, content=b"\xff{", headers={"Content-Type": "x/y"}),
        api.http.request(method, sampled, params={"limit": "-1", "after": "x", "format": "?"}),
        api.http.request(method, sampled, headers={"Range": "bytes=9999999-"}),
    ]
    assert [answer.status_code // 100 for answer in answers[:2]] == [4, 4]
    for answer in answers:
        if answer.status_code >= 400:
            assert answer.headers["content-type"] == "application/problem+json"
            problem = ProblemDocument.model_validate_json(answer.content)
            assert problem.status == answer.status_code and problem.detail and problem.remedy
    assert answers[0].status_code == 405
    assert answers[0].headers["Allow"] == ", ".join(sorted(map(str.upper, CONTRACT["paths"][path])))


def test_health_and_figures(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """Alive, ready, and what Prometheus reads."""
    monkeypatch.setattr(health, "FIGURES_SECONDS", 0)
    assert "morph_queue_age_seconds 0.0" in api.http.get("/metrics").text
    api.submit()
    until(lambda: "morph_queue_age_seconds 0.0" not in api.http.get("/metrics").text)
    for slot in ("a-slot0", "a-slot1", "a-slot0"):
        api.context.adoptions.add(slot)
    assert api.http.get("/livez").json() == api.http.get("/readyz").json() == {"status": "ok"}
    figures = api.http.get("/metrics").text
    assert 'morph_jobs{state="queued"} 1.0' in figures
    assert 'morph_job_failures_total{kind="input"} 0.0' in figures
    assert "morph_adoptions_total 3.0" in figures
    values = dict(line.rsplit(" ", 1) for line in figures.splitlines() if line[0] != "#")
    assert float(values["morph_queue_age_seconds"]) > 0
    assert float(values["morph_disk_free_bytes"]) > 0
    assert 'morph_requests_total{operation="submitJob",status="202"} 1.0' in figures


def test_figures_are_kept_for_a_while(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often they are asked for, the database tells them once."""
    monkeypatch.setattr(health, "FIGURES_SECONDS", PATIENCE)
    first = api.http.get("/metrics").text
    api.submit()
    later = api.http.get("/metrics").text
    for figures in (first, later):
        assert 'morph_jobs{state="queued"} 0.0' in figures
    assert 'morph_requests_total{operation="submitJob",status="202"} 1.0' in later


def test_a_fault_of_the_service_is_a_problem_too(api: Api) -> None:
    """Without its tables the API answers 503, and is not ready for anything but that."""
    with api.context.engine.begin() as connection:
        connection.exec_driver_sql("alter table morph_keys rename to gone")
    api.context.authenticator.invalidate()  # the keys are read again
    answer = api.http.get("/v1/jobs")
    assert answer.status_code == 503 and answer.json()["remedy"]


def test_every_fault_is_counted(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """An answer that the framework makes as its last resort is in the figures, too."""
    monkeypatch.setattr(api.context, "queue", None)
    once = {"Connection": "close"}  # the server closes it after a fault
    assert api.http.get("/v1/workers", headers=once).status_code == 500
    monkeypatch.undo()
    figures = api.http.get("/metrics").text
    assert 'morph_requests_total{operation="listWorkers",status="500"} 1.0' in figures


@pytest.mark.parametrize("page", ["/docs", "/redoc"])
def test_the_documentation_needs_no_other_host(api: Api, page: str) -> None:
    """What a page of documentation loads comes from the service itself."""
    loaded = re.findall(r'(?:src|href)="([^"]+)"', api.http.get(page).text)
    assert loaded
    for address in loaded:
        assert address.startswith("/")
        assert api.http.get(address).status_code == 200
