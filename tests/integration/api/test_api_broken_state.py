"""Damage to one row or file, and requests that race, touch no other job and answer no 500."""

from __future__ import annotations

import base64
import json
import pickle
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
import sqlalchemy as sa

from chamfer_morph.schemas import Outcome
from chamfer_morph.worker import storage
from chamfer_morph.worker.dbos_adapter import SERIALIZER
from chamfer_morph.worker.queue import JobChangedError, JobQueue
from chamfer_morph.worker.storage import Storage, StoreUnavailableError
from morph_engine.files import file_sha256
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import spool_path
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


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("placement", "{"), ("placement", "[]"), ("placement", 5), ("placement", '{"up": "y"}'),
        ("via_names", "no"), ("via_names", "[1]"), ("via_names", "3"), ("estimate", "soon"),
        ("estimate", []), ("sweep", 5), ("reused_from", {}), ("owner", 1), ("name", None),
        ("priority", {}),
    ],
)  # fmt: skip
def test_a_damaged_attribute_hides_no_other(either: Api, name: str, value: Any) -> None:
    """What is attached to a job is looked at when its row is read."""
    jobs = [either.submit(overrides=COARSE)["id"] for _ in range(3)]
    record = either.context.queue.get(jobs[1])
    assert record is not None
    change(either, jobs[1], attributes=record.attributes | {name: value})
    page = either.http.get("/v1/jobs")
    assert page.status_code == 200, page.text
    assert [job["id"] for job in page.json()["items"]] == [jobs[2], jobs[0]]
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


@pytest.mark.parametrize("of", ["frames", "the result"])
def test_damaged_files_are_a_fault_of_the_service(
    api: Api, run: RunRecord, of: str, caplog: pytest.LogCaptureFixture
) -> None:
    """500 for what cannot be read, the log says what that is, and no answer says where it lies."""
    job = api.running(run) if of == "frames" else api.finished(run)
    result = api.context.storage.result_path(job)
    spool = spool_path(result)
    if of == "the result":
        shutil.rmtree(spool)
    for path in [result] if of == "the result" else spool.glob("frame-*"):
        path.write_bytes(path.read_bytes()[:300])
    for address in ("frames/0", "frames/0/surface", "particles", "frames/1/fields/det_f", "colors"):
        answer = api.http.get(f"/v1/jobs/{job}/{address}")
        assert f"{api.settings.data_dir}" not in answer.text, address
        assert answer.status_code != 422, address
    answer = api.http.get(f"/v1/jobs/{job}/frames/0")
    assert answer.status_code == 500 and "damaged" in answer.json()["detail"]
    assert f"{result}" in caplog.text


def test_no_problem_says_where_files_lie(api: Api, run: RunRecord) -> None:
    """A disk that refuses is told, without the folder."""
    job = api.running(run)
    assert api.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
    api.context.storage.result_path(job).mkdir()  # in the way of the result
    answer = api.http.get(f"/v1/jobs/{job}/result")
    assert answer.status_code == 503 and "Cannot write" in answer.json()["detail"]
    assert f"{api.settings.data_dir}" not in answer.text


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


def reported(api: Api, job: str) -> str:
    """What a worker reports of a job with the result that this one has."""
    path = api.context.storage.result_path(job)
    outcome = Outcome(
        sha256=file_sha256(path), size_bytes=path.stat().st_size, frames=2, metrics={},
        particle_count=1, target_count=1, cpu_seconds=0, peak_memory_mb=0,
    )  # fmt: skip
    return SERIALIZER.serialize(outcome.model_dump(mode="json"))


@pytest.mark.parametrize("fault", ["missing", "a byte turned"])
def test_a_result_that_is_lost_on_the_server(
    either: Api, run: RunRecord, fault: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The answer says so, rather than that nothing was computed; the log names the file."""
    job = either.finished(run)
    path = either.context.storage.result_path(job)
    shutil.rmtree(spool_path(path))
    change(either, job, status="SUCCESS", output=reported(either, job))
    address = f"/v1/jobs/{job}/result"
    assert either.http.get(address).content == path.read_bytes()
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.unlink() if fault == "missing" else path.write_bytes(content)
    answer = either.http.get(address)
    assert answer.status_code == 500
    assert answer.json()["detail"] == "The result of the job is missing or damaged on the server."
    assert "administrator" in answer.json()["remedy"] and str(path) in caplog.text
    assert either.http.get(f"/v1/jobs/{job}").json()["state"] == "succeeded"


@contextmanager
def interrupted(instant: int) -> Iterator[None]:
    """SystemExit at the begin or end of the so-manieth call in the package of queue and storage."""
    folder = str(Path(storage.__file__).parent)
    left = instant

    def note(frame: FrameType, event: str, _: Any) -> None:
        nonlocal left
        if event in ("call", "return") and frame.f_code.co_filename.startswith(folder):
            left -= 1
            if left < 0:
                raise SystemExit

    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(None)


def test_a_retry_may_break_off_anywhere(api: Api, run: RunRecord, tmp_path: Path) -> None:
    """Afterwards the job has succeeded, with its result, or is queued; the next retry is whole."""
    job, queue = api.finished(run), api.context.queue
    folder = api.context.storage.job_dir(job)
    shutil.copytree(folder, tmp_path / "kept")
    output = reported(api, job)
    seen = []
    for instant in count():
        shutil.copytree(tmp_path / "kept", folder, dirs_exist_ok=True)
        change(api, job, status="SUCCESS", output=output)
        try:
            with interrupted(instant):
                queue.retry(job)
        except (SystemExit, sa.exc.OperationalError):  # as which SQLite passes it on
            state = queue.states([job])[job].value
            seen.append(state)
        else:
            break
        if state == "succeeded":
            assert api.http.get(f"/v1/jobs/{job}/result").status_code == 200, instant
            queue.retry(job)
        assert queue.states([job])[job].value == "queued", instant
        api.context.storage.discard_if_marked(job, wait_seconds=0)  # as its worker does
        assert [path.name for path in folder.iterdir()] == ["lock"], instant
    assert {*seen} == {"succeeded", "queued"} and len(seen) > 20, seen


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


def test_a_job_that_is_resumed_meanwhile_stays(
    either: Api, run: RunRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look at a job that is to be deleted and its deletion it may change."""
    job = either.finished(run)
    noted = either.context.deletions.noted

    def resume_first(job_id: str) -> AbstractContextManager[None]:
        either.context.queue.resume(job_id)
        return noted(job_id)

    monkeypatch.setattr(either.context.deletions, "noted", resume_first)
    assert either.http.delete(f"/v1/jobs/{job}").status_code == 409
    assert either.http.get(f"/v1/jobs/{job}").json()["state"] == "queued"
    assert either.http.get(f"/v1/jobs/{job}/frames/1").status_code == 200


def test_a_job_goes_although_its_files_cannot_now(
    either: Api, run: RunRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They follow later."""

    def refuse(*_: object) -> None:
        raise StoreUnavailableError("The object store does not answer.", "")

    job = either.finished(run)
    with monkeypatch.context() as patch:
        patch.setattr(Storage, "remove_job", refuse)
        assert either.http.delete(f"/v1/jobs/{job}").status_code == 204
    assert either.http.get(f"/v1/jobs/{job}").status_code == 404
    folder = either.context.storage.job_dir(job)
    assert folder.exists()
    assert either.context.deletions.finish(abandoned_seconds=0) == [job]
    assert not folder.exists()
