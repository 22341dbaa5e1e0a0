"""Damage to one row or file, and requests that race, touch no other job and answer no 500."""

from __future__ import annotations

import base64
import json
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from chamfer_morph.worker.queue import JobChangedError, JobQueue
from chamfer_morph.worker.storage import Storage
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import COARSE, Api


class Bomb:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def change(api: Api, job: str, **values: Any) -> None:
    """Write to the row of a job, as no process of ours does."""
    tables = api.context.queue._client._sys_db.tables
    with api.context.queue._workflows.begin() as connection:
        for table in (tables.workflow_input, tables.workflow_status):
            known = {name: value for name, value in values.items() if name in table.c}
            if "updated_at" in table.c:
                known["updated_at"] = table.c.updated_at + 1
            if known:
                mine = table.c.workflow_uuid == job
                connection.execute(sa.update(table).where(mine).values(**known))


@pytest.mark.parametrize("inputs", ["{", "null", '{"positionalArgs": [{"no": "spec"}]}'])
def test_a_row_that_cannot_be_read_hides_no_other(either: Api, inputs: str) -> None:
    """Lists go on behind it, page by page, and it is not there itself."""
    jobs = [either.submit(overrides=COARSE)["id"] for _ in range(4)]
    change(either, jobs[1], inputs=inputs)
    found, cursor = [], None
    while True:
        query = {"limit": 1} | ({"cursor": cursor} if cursor else {})
        page = either.http.get("/v1/jobs", params=query)
        assert page.status_code == 200, page.text
        found += [job["id"] for job in page.json()["items"]]
        cursor = page.json()["next_cursor"]
        if cursor is None:
            break
    assert found == [jobs[3], jobs[2], jobs[0]]
    assert either.http.get(f"/v1/jobs/{jobs[1]}").status_code == 404


def test_a_pickled_row_is_never_unpickled(either: Api, tmp_path: Path) -> None:
    """Whoever writes to the database runs no code in the API."""
    traces = [tmp_path / name for name in ("input", "output", "error")]
    bombs = [base64.b64encode(pickle.dumps(Bomb(path))).decode() for path in traces]
    job = either.submit(overrides=COARSE)["id"]
    change(
        either, job, inputs=bombs[0], output=bombs[1], error=bombs[2], status="SUCCESS",
        serialization="py_pickle",
    )  # fmt: skip
    assert either.http.get(f"/v1/jobs/{job}").status_code == 404
    assert either.http.get("/v1/jobs").json()["items"] == []
    assert not any(path.exists() for path in traces)


def test_an_outcome_that_cannot_be_read_is_a_failure(either: Api) -> None:
    """The job is shown with what to do."""
    job = either.submit(overrides=COARSE)["id"]
    change(either, job, status="SUCCESS", output='{"frames": "many"}')
    shown = either.http.get(f"/v1/jobs/{job}").json()
    assert shown["state"] == "failed" and "Resume" in shown["problem"]["remedy"]


@pytest.mark.parametrize(
    "line",
    [
        {"type": "frame", "data": {}},
        {"type": "frame", "data": {"frame": "x", "attempt": 1, "metrics": {}, "seconds": 1}},
        {"type": "frame", "data": {"frame": 0, "attempt": 1, "metrics": "no", "seconds": 1}},
        {"type": "frame", "data": {"frame": 0, "attempt": 1, "metrics": {"a": "b"}, "seconds": 1}},
        {"type": "attempt", "data": {"attempt": "one"}},
        None,
    ],
)
def test_a_damaged_log_hides_no_job(api: Api, line: Any) -> None:
    """A job whose log cannot be read is shown without progress."""
    jobs = [api.submit(overrides=COARSE)["id"] for _ in range(2)]
    log = api.context.storage.events(jobs[0]).path
    log.parent.mkdir()
    if line is None:
        log.mkdir()
    else:
        log.write_text(json.dumps(line | {"at": "2026-01-01T00:00:00Z"}) + "\n")
    page = api.http.get("/v1/jobs")
    assert page.status_code == 200, page.text
    assert [job["id"] for job in page.json()["items"]] == jobs[::-1]
    assert api.http.get(f"/v1/jobs/{jobs[0]}").json()["progress"]["frames"] == 3


@pytest.mark.parametrize("text", ["", "{", "[]", '{"report": 1}'])
def test_a_damaged_report_hides_no_mesh(api: Api, cube: bytes, text: str) -> None:
    """It is not there, and comes again with the next upload."""
    meshes = [
        api.http.post("/v1/meshes", params={"name": "a.obj"}, content=cube + b"#" * n).json()["id"]
        for n in range(2)
    ]
    report = api.settings.data_dir / "meshes" / meshes[0] / "report.json"
    report.write_text(text)
    listed = api.http.get("/v1/meshes")
    assert listed.status_code == 200, listed.text
    assert [mesh["id"] for mesh in listed.json()["items"]] == meshes[1:]
    assert api.http.get(f"/v1/meshes/{meshes[0]}").status_code == 404
    again = api.http.post("/v1/meshes", params={"name": "a.obj"}, content=cube)
    assert again.json()["id"] == meshes[0] and again.is_success


def test_a_key_without_a_known_scope_is_no_key(api: Api) -> None:
    """It locks nobody else out."""
    secret = api.http.post("/v1/keys", json={"name": "a", "scopes": ["admin"]}).json()["secret"]
    api.context.api_keys.add("b", [])
    api.context.authenticator.invalidate()
    header = {"Authorization": f"Bearer {secret}"}
    assert api.http.get("/v1/jobs", headers=header).status_code == 200
    assert len(api.http.get("/v1/keys", headers=header).json()) == 2


def test_a_retry_that_breaks_off_leaves_the_result(
    either: Api, run: RunRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files go once the job is in the queue; a resume later does not begin anew."""
    job = either.finished(run)
    result = either.context.storage.result_path(job)

    def fail(*_: object, **__: object) -> None:
        raise SystemExit

    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(JobQueue, "_rewind", fail)
        either.context.queue.retry(job)
    assert either.http.get(f"/v1/jobs/{job}").json()["state"] == "cancelled"
    assert either.http.get(f"/v1/jobs/{job}/result").status_code == 200
    assert either.http.post(f"/v1/jobs/{job}/resume").status_code == 202
    either.context.storage.discard_if_marked(job, wait_seconds=0)  # as its worker does
    assert result.exists()

    assert either.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(Storage, "discard_if_marked", fail)
        either.context.queue.retry(job)
    assert either.http.get(f"/v1/jobs/{job}").json()["state"] == "queued" and result.exists()
    with pytest.raises(JobChangedError):  # too late, and no reason to keep what it had
        either.context.queue.resume(job)
    either.context.storage.discard_if_marked(job, wait_seconds=0)  # as its worker does
    assert [path.name for path in result.parent.iterdir()] == ["lock"]


def test_a_refused_retry_discards_nothing(either: Api, run: RunRecord) -> None:
    """What a running job has computed stays when somebody retries it too late."""
    job = either.running(run)
    change(either, job, status="PENDING")
    with pytest.raises(Exception, match="PENDING"):
        either.context.queue.retry(job)
    either.context.storage.discard_if_marked(job, wait_seconds=0)
    assert either.http.get(f"/v1/jobs/{job}/frames/1").status_code == 200


def test_racing_requests_are_conflicts_at_worst(either: Api, run: RunRecord) -> None:
    """Whatever comes at the same time: one gets its way, the others 404 or 409."""
    for _ in range(5):
        job = either.finished(run)
        actions = ["resume", "retry", "cancel", "delete"] * 3

        def act(action: str, job: str = job) -> int:
            if action == "delete":
                return either.http.delete(f"/v1/jobs/{job}").status_code
            return either.http.post(f"/v1/jobs/{job}/{action}").status_code

        with ThreadPoolExecutor(len(actions)) as pool:
            answers = [*pool.map(act, actions)]
        assert set(answers) <= {202, 204, 404, 409}, answers
        assert either.http.get("/v1/jobs").status_code == 200
