"""What a key may have, however much it asks for at the same time; and how much disk is counted."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa

from chamfer_morph.server.database import reservations
from chamfer_morph.server.database.tables import ReservationRow
from chamfer_morph.worker import service_log
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.janitor import delete_expired
from chamfer_morph.worker.settings import Settings
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import COARSE, MORPH, Api, ApiProcess
from tests.patience import PATIENCE, until


def test_parallel_submits_stay_within_the_quota(
    make_api: Callable[..., Api], database_url: str
) -> None:
    """Of many jobs at once as many are let in as one after the other; so it is with retries."""
    api = make_api(queued_jobs_per_key=5, database_url=database_url)
    body = MORPH | {"overrides": COARSE}
    with ThreadPoolExecutor(20) as pool:
        answers = [*pool.map(lambda _: api.http.post("/v1/jobs", json=body), range(40))]
    assert {answer.status_code for answer in answers} == {202, 429}
    assert sum(answer.status_code == 202 for answer in answers) <= 5
    while api.http.post("/v1/jobs", json=body).status_code == 202:
        pass
    jobs = [job["id"] for job in api.http.get("/v1/jobs").json()["items"]]
    assert len(jobs) == 5
    sweep = {"sources": [MORPH["source"]], "targets": [MORPH["target"]], "seeds": [1, 2]}
    assert api.http.post("/v1/sweeps", json=sweep).status_code == 429
    for job in jobs[:2]:
        assert api.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
    assert api.http.post("/v1/sweeps", json=sweep).status_code == 202
    assert api.http.post(f"/v1/jobs/{jobs[0]}/retry").status_code == 429


def test_a_sweep_that_is_asked_for_again_stays_within_the_quota(
    make_api: Callable[..., Api], database_url: str
) -> None:
    """Jobs that were deleted count as new ones, those that are there do not."""
    api = make_api(queued_jobs_per_key=5, database_url=database_url)

    def sweep(name: str) -> httpx.Response:
        body = {"sources": [MORPH["source"]], "targets": [MORPH["target"]], "seeds": [1, 2, 3, 4]}
        overrides = {"overrides": COARSE}
        return api.http.post("/v1/sweeps", json=body | overrides, headers={"Idempotency-Key": name})

    def delete_all() -> None:
        for job in api.http.get("/v1/jobs").json()["items"]:
            assert api.http.post(f"/v1/jobs/{job['id']}/cancel").status_code == 202
            assert api.http.delete(f"/v1/jobs/{job['id']}").status_code == 204

    for name in ("first", "second"):
        assert sweep(name).status_code == 202
        assert sweep(name).status_code == 200
        delete_all()
    assert [sweep(name).status_code for name in ("first", "second", "first")] == [200, 429, 200]
    assert len(api.http.get("/v1/jobs").json()["items"]) == 4


@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
def test_a_mesh_that_another_process_stores_meanwhile_counts(
    make_api: Callable[..., Api], monkeypatch: pytest.MonkeyPatch, cube: bytes, database_url: str
) -> None:
    """Before whichever of the looks that an upload takes at the disk until it is stored.

    On Postgres, as SQLite lets nobody else write during the last of them.
    """
    api = make_api(disk_bytes_per_key=1_000_000, database_url=database_url)
    meshes, totals, add = api.context.meshes, api.context.meshes.totals, api.context.meshes.add
    other = "0" * 64
    looks: list[str] = []
    overtaken_before = 0

    def look(owner: str) -> tuple[int, int]:
        looks.append(owner)
        if len(looks) == overtaken_before:
            add(owner, other, "of_another_process.obj", 600_000)
        return totals(owner)

    def store(*arguments: Any) -> bool:
        monkeypatch.setattr(meshes, "totals", totals)
        return add(*arguments)

    def upload() -> httpx.Response:
        looks.clear()
        monkeypatch.setattr(meshes, "totals", look)
        content = cube + b"#" * 600_000 + b"\n"
        return api.http.post("/v1/meshes", params={"name": "cube.obj"}, content=content)

    monkeypatch.setattr(meshes, "add", store)
    mesh = upload()
    assert mesh.status_code == 201
    (owner,), needed = set(looks), len(looks)
    assert api.http.delete(f"/v1/meshes/{mesh.json()['id']}").is_success
    for overtaken_before in range(1, needed + 1):
        api.context.quotas.invalidate(owner)
        assert upload().status_code == 413
        assert len(looks) >= overtaken_before
        assert totals(owner) == (1, 600_000)
        meshes.remove(owner, other)


def test_quotas_hold_over_processes(
    start_apis: Callable[..., list[ApiProcess]], database_url: str, tmp_path: Path, cube: bytes
) -> None:
    """However many processes are asked at the same time; what is refused leaves no reservation."""
    settings = Settings(
        _env_file=None,
        data_dir=tmp_path,
        database_url=database_url,
        port=0,
        queued_jobs_per_key=23,
        meshes_per_key=3,
        disk_bytes_per_key=60_000_000,  # of which the jobs are to fill 12
    )
    apis = start_apis(settings)
    body = MORPH | {"overrides": COARSE}

    def submit(index: int) -> int:
        return apis[index % 2].http.post("/v1/jobs", json=body).status_code

    def upload(index: int) -> int:
        http, content = apis[index % 2].http, cube + b"#" * index + b"\n"
        return http.post("/v1/meshes", params={"name": "cube.obj"}, content=content).status_code

    with ThreadPoolExecutor(40) as pool:
        answers = [*pool.map(submit, range(200))]
        assert set(answers) == {202, 429} and answers.count(202) <= 23
        while submit(0) == 202:
            pass
        assert len(apis[1].http.get("/v1/jobs", params={"limit": 100}).json()["items"]) == 23
        large = [*pool.map(upload, [25_000_000, 25_000_001])]
        assert large.count(201) <= 1 and set(large) <= {201, 413}
        answers = [*pool.map(upload, range(12))]
    assert set(answers) == {201, 429} and answers.count(201) <= 3
    index = 12
    while upload(index) == 201:
        index += 1
    assert len(apis[0].http.get("/v1/meshes").json()["items"]) == 3
    engine = database(settings)
    with engine.connect() as connection:
        assert connection.execute(sa.select(sa.func.count(ReservationRow.id))).scalar_one() == 0
    engine.dispose()


def test_parallel_uploads_stay_within_the_quota(make_api: Callable[..., Api], cube: bytes) -> None:
    """Meshes on their way in count."""
    api = make_api(meshes_per_key=3)

    def upload(index: int) -> int:
        query = {"name": "cube.obj"}
        content = cube + b"#" * index
        return api.http.post("/v1/meshes", params=query, content=content).status_code

    with ThreadPoolExecutor(12) as pool:
        answers = [*pool.map(upload, range(12))]
    assert set(answers) == {201, 429} and answers.count(201) <= 3
    index = 12
    while upload(index) == 201:
        index += 1
    assert len(api.http.get("/v1/meshes").json()["items"]) == 3


def test_temporary_files_count(make_api: Callable[..., Api], cube: bytes) -> None:
    """Two uploads that would fill the disk of a key together are not both taken."""
    api = make_api(disk_bytes_per_key=1_000_000)
    begun, go_on = threading.Barrier(3), threading.Event()

    def content() -> Iterator[bytes]:
        yield cube + b"#" * 600_000 + b"\n"
        begun.wait(PATIENCE)
        go_on.wait(PATIENCE)
        yield b"#\n" * 10

    def upload(_: int) -> int:
        with httpx.Client(base_url=api.http.base_url, timeout=PATIENCE) as http:
            query = {"name": "cube.obj"}
            return http.post("/v1/meshes", params=query, content=content()).status_code

    with ThreadPoolExecutor(2) as pool:
        answers = pool.map(upload, range(2))
        begun.wait(PATIENCE)
        go_on.set()
        assert sorted(answers) == [201, 413]
    assert not api.uploads()
    assert api.context.quotas.arrived("", 0) == 0


def test_disk_is_summed_up(either: Api, run: RunRecord) -> None:
    """The sum is that of all folders, before and after the janitor has measured them.

    What is unfinished counts with what it is expected to fill.
    """
    sizes, storage = either.context.job_sizes, either.context.storage

    def walked() -> int:
        expected = either.context.queue.expected_bytes("")
        there = {path.name for path in (storage.root / "jobs").iterdir()}
        return sum(
            max(storage.job_bytes(job), expected.get(job, 0)) for job in there | expected.keys()
        )

    jobs = [either.finished(run) for _ in range(3)]
    running = either.running(run)
    assert sizes.of("") == walked() > 0
    sizes.measure_finished()
    assert sizes.of("") == walked()
    expected = either.context.queue.expected_bytes("")
    assert expected.keys() == {running} and expected[running] > 0
    assert sizes.total() == walked() - max(storage.job_bytes(running), expected[running])
    later = either.finished(run)
    assert sizes.of("") == walked()
    either.http.get(f"/v1/jobs/{jobs[0]}/frames/0/surface")
    assert either.http.delete(f"/v1/jobs/{jobs[1]}").status_code == 204
    assert either.http.post(f"/v1/jobs/{jobs[2]}/retry").status_code == 202
    assert sizes.of("") == walked()
    sizes.measure_finished()
    assert sizes.of("") == walked()
    assert [job for job, _ in sizes.oldest(9)] == [jobs[0], later]


@pytest.mark.parametrize("hours", [-30, 30])
def test_jobs_of_a_host_with_a_wrong_clock_count(either: Api, run: RunRecord, hours: int) -> None:
    """Whether it is ahead or behind, they count, and so do those that finish after them."""
    sizes, storage = either.context.job_sizes, either.context.storage
    wrong = [either.finished(run) for _ in range(2)]
    sizes.measure_finished()
    workflows = either.context.queue._workflows
    table = workflows.table
    wrong.append(either.finished(run))
    with workflows.begin() as connection:
        connection.execute(
            sa.update(table)
            .where(table.c.workflow_uuid == wrong[-1])
            .values(completed_at=table.c.completed_at + hours * 3_600_000)
        )
    sizes.measure_finished()
    jobs = [*wrong, either.finished(run)]
    expected = sum(map(storage.job_bytes, jobs))
    assert sizes.of("") == expected
    sizes.measure_finished()
    assert sizes.of("") == sizes.total() == expected


def test_the_oldest_go_beyond_the_space(
    either: Api, run: RunRecord, caplog: pytest.LogCaptureFixture
) -> None:
    """As many as it takes, and none that has not finished; the log tells which and why."""
    service_log.set_up("text")
    sizes, storage, queue = either.context.job_sizes, either.context.storage, either.context.queue
    deletions = either.context.deletions
    jobs = [either.finished(run) for _ in range(3)]
    running = either.running(run)
    room = storage.job_bytes(jobs[1]) + storage.job_bytes(jobs[2])
    settings = either.settings.model_copy(update={"retention_bytes": room})
    assert delete_expired(settings, queue, sizes, deletions) == [jobs[0]]
    assert delete_expired(settings, queue, sizes, deletions) == []
    by_age = either.settings.model_copy(update={"retention_days": 1e-9})
    assert delete_expired(by_age, queue, sizes, deletions, by_age=False) == []
    assert delete_expired(by_age, queue, sizes, deletions) == jobs[1:]
    left: list[Path] = [*(storage.root / "jobs").iterdir()]
    assert [path.name for path in left] == [running] and sizes.total() == 0
    audit = (record for record in caplog.records if record.name == "chamfer_morph.audit")
    lines = [json.loads(record.getMessage()) for record in audit]
    deleted = [line for line in lines if line["operation"] == "deleteJob"]
    assert [(line["job"], line["why"].split()[0]) for line in deleted] == [
        (jobs[0], "finished"), (jobs[1], "older"), (jobs[2], "older"),
    ]  # fmt: skip


def test_a_job_that_no_worker_has_room_for_is_refused(make_api: Callable[..., Api]) -> None:
    """At once, with what it needs; a coarser one is taken."""
    api = make_api(job_memory_bytes=400_000_000)
    fine = api.http.post(
        "/v1/jobs", json=MORPH | {"overrides": {"sampling.points_per_cell_edge": 4}}
    )
    assert fine.status_code == 422
    assert "400 MB" in fine.json()["detail"]
    assert "sampling.points_per_cell_edge" in fine.json()["remedy"]
    api.submit(overrides={"sampling.points_per_cell_edge": 2})


def test_particles_follow_the_grid(make_api: Callable[..., Api]) -> None:
    """A finer one takes more of them, and memory; on a coarse one a shape has too few."""
    api = make_api(job_memory_bytes=1_800_000_000)
    for settings, cause in (
        ({"grid.dx": 0.2, "time.dt": 0.0005, "sampling.points_per_cell_edge": 1}, "1,800 MB"),
        ({"grid.dx": 8, "sampling.points_per_cell_edge": 4}, "fewer than 500"),
    ):
        answer = api.http.post("/v1/jobs", json=MORPH | {"method": "joint", "overrides": settings})
        assert answer.status_code == 422 and cause in answer.json()["detail"], answer.text


def test_a_job_that_the_disk_has_no_room_for_is_refused(make_api: Callable[..., Api]) -> None:
    """At once, with what it needs: its frames count, and the states that it keeps."""
    api = make_api(disk_bytes_per_key=100_000_000)
    sweep = {"sources": [MORPH["source"]], "targets": [MORPH["target"]], "overrides": COARSE}
    for path, body in (
        ("/v1/jobs", MORPH | {"overrides": COARSE, "frames": 10_000}),
        ("/v1/jobs", MORPH | {"overrides": COARSE, "frames": 300, "states_every": 1}),
        ("/v1/sweeps", sweep | {"frames": 300, "seeds": [*range(20)]}),
    ):
        answer = api.http.post(path, json=body)
        assert answer.status_code == 413, answer.text
        assert "0.1 GB left" in answer.json()["detail"]
        assert "states_every" in answer.json()["remedy"]
    assert api.http.get("/v1/jobs").json()["items"] == []
    job = api.submit(overrides=COARSE, frames=300)["id"]
    assert api.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
    api.submit(overrides=COARSE, frames=300, states_every=100)


def test_jobs_that_wait_count_with_what_they_will_fill(
    make_api: Callable[..., Api], database_url: str
) -> None:
    """One after the other, at the same time, and when the disk is measured anew."""
    api = make_api(disk_bytes_per_key=2_000_000, database_url=database_url)
    body = MORPH | {"overrides": COARSE}
    with ThreadPoolExecutor(6) as pool:
        answers = [*pool.map(lambda _: api.http.post("/v1/jobs", json=body), range(6))]
    needed = api.context.job_sizes.of("")
    let_in = sum(answer.status_code == 202 for answer in answers)
    assert {answer.status_code for answer in answers} == {202, 413}
    assert needed < 2_000_000 < needed * (let_in + 1) / let_in
    api.context.quotas.invalidate("")
    assert api.http.post("/v1/jobs", json=body).status_code == 413
    job = api.http.get("/v1/jobs").json()["items"][0]["id"]
    assert api.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
    assert api.http.post("/v1/jobs", json=body).status_code == 202
    for action in ("resume", "retry"):
        assert api.http.post(f"/v1/jobs/{job}/{action}").status_code == 413


def test_a_form_counts_once(make_api: Callable[..., Api], cube: bytes) -> None:
    """A file of most of what is left is taken as a form, too."""
    api = make_api(disk_bytes_per_key=1_000_000)
    content = cube + b"#" * 700_000 + b"\n"
    answer = api.http.post("/v1/meshes", files={"file": ("cube.obj", content)})
    assert answer.status_code == 201, answer.text
    assert api.context.quotas.arrived("", 0) == 0


def test_files_of_a_refused_job_are_not_kept(api: Api, cube: bytes) -> None:
    """Nor do they stay if they are new; one that was there before does."""
    files = {"source": ("new.obj", cube + b"# new\n"), "target": ("cube.obj", cube)}
    kept = api.http.post("/v1/meshes", params={"name": "cube.obj"}, content=cube).json()["id"]
    for wrong in ({"preset": "nope"}, {"overrides": {"sampling.points_per_cell_edge": 99}}):
        answer = api.http.post("/v1/jobs", data={"job": json.dumps(wrong)}, files=files)
        assert answer.status_code == 422
        assert [mesh["id"] for mesh in api.http.get("/v1/meshes").json()["items"]] == [kept]


def test_a_job_deleted_while_it_is_measured_leaves_no_size(
    either: Api, run: RunRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does one that begins again."""
    storage, sizes = either.context.storage, either.context.job_sizes
    deleted, begun = either.finished(run), either.finished(run)
    job_bytes = storage.job_bytes

    def overtaken(job: str) -> int:
        size = job_bytes(job)
        monkeypatch.setattr(storage, "job_bytes", job_bytes)
        assert either.http.delete(f"/v1/jobs/{deleted}").status_code == 204
        assert either.http.post(f"/v1/jobs/{begun}/retry").status_code == 202
        return size

    monkeypatch.setattr(storage, "job_bytes", overtaken)
    sizes.measure_finished()
    assert [*sizes.oldest(9)] == []


def test_a_sweep_repeated_while_it_is_queued_is_to_wait(
    make_api: Callable[..., Api], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the same sweep, and needs no more room; later it is answered as there."""
    api = make_api(queued_jobs_per_key=3)
    body = {"sources": [MORPH["source"]], "targets": [MORPH["target"]], "seeds": [1, 2]}
    key = {"Idempotency-Key": "one"}
    repeated: list[httpx.Response] = []
    enqueue = api.context.queue.enqueue

    def slow(*arguments: Any, **named: Any) -> bool:
        if not repeated:
            repeated.append(httpx.Response(0))
            repeated[:] = [api.http.post("/v1/sweeps", json=body, headers=key)]
        return enqueue(*arguments, **named)

    monkeypatch.setattr(api.context.queue, "enqueue", slow)
    first = api.http.post("/v1/sweeps", json=body, headers=key)
    assert first.status_code == 202
    assert repeated[0].status_code == 503 and repeated[0].headers["Retry-After"] == "5"
    again = api.http.post("/v1/sweeps", json=body, headers=key)
    assert again.status_code == 200 and again.json()["id"] == first.json()["id"]


def test_a_fork_that_nobody_has_room_for_is_refused(
    make_api: Callable[..., Api], run: RunRecord, tmp_path: Path
) -> None:
    """Memory and disk are asked for as for any job."""
    first = make_api(data_dir=tmp_path / "data")
    job = first.finished(run)
    used = first.context.storage.job_bytes(job)
    for settings, status, cause in (
        ({"job_memory_bytes": 1_000_000}, 422, "the limit is 1 MB per job"),
        ({"disk_bytes_per_key": used + 1000}, 413, "0.0 GB left"),
    ):
        api = make_api(data_dir=tmp_path / "data", **settings)
        answer = api.http.post(f"/v1/jobs/{job}/fork", json={"frame": 1, "states_every": 1})
        assert answer.status_code == status and cause in answer.json()["detail"], answer.text
        assert len(api.http.get("/v1/jobs").json()["items"]) == 1
    fork = first.http.post(f"/v1/jobs/{job}/fork", json={"frame": 1, "states_every": 1})
    assert fork.status_code == 202, fork.text


def test_an_upload_that_has_lost_its_place_is_counted_again(
    make_api: Callable[..., Api], monkeypatch: pytest.MonkeyPatch, cube: bytes
) -> None:
    """It comes slowly, its place expires, and another one takes the last: it is refused."""
    api = make_api(meshes_per_key=1)
    go_on = threading.Event()

    def content() -> Iterator[bytes]:
        yield cube
        go_on.wait(PATIENCE)
        yield b"#\n"

    def upload(content: Iterator[bytes] | bytes) -> int:
        query = {"name": "cube.obj"}
        with httpx.Client(base_url=api.http.base_url, timeout=PATIENCE) as http:
            return http.post("/v1/meshes", params=query, content=content).status_code

    with ThreadPoolExecutor(1) as pool:
        monkeypatch.setattr(reservations, "LIFETIME_SECONDS", -1)
        slow = pool.submit(upload, content())
        until(api.uploads)
        monkeypatch.undo()
        other = upload(cube)
        go_on.set()
        assert (other, slow.result()) == (201, 429)
    (mesh,) = api.http.get("/v1/meshes").json()["items"]
    assert api.http.delete(f"/v1/meshes/{mesh['id']}").is_success
    assert upload(cube) == 201
