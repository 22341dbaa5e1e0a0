"""Jobs and sweeps over HTTP: submit, list, act, limits, idempotency; no worker runs here."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from chamfer_morph.cli.arguments import default_output
from chamfer_morph.server.routes.job_view import file_stem
from morph_engine import configure
from morph_engine.morphing import prepare
from morph_engine.results.spool import Spool
from tests.integration.api.conftest import COARSE, MORPH, Api


def test_a_submitted_job_waits_in_the_queue(either: Api) -> None:
    """The answer is 202 with its place, its position and an estimate of the time left."""
    answer = either.http.post("/v1/jobs", json=MORPH | {"name": "first", "seed": 7, "priority": 5})
    job = answer.json()
    assert answer.status_code == 202, answer.text
    assert answer.headers["Location"] == f"/v1/jobs/{job['id']}" and "Retry-After" in answer.headers
    assert (job["state"], job["queue_position"], job["progress"]["frames"]) == ("queued", 0, 3)
    assert job["progress"]["seconds_left"] > 0
    assert (job["seed"], job["priority"], job["method"]) == (7, 5, "flow")
    assert either.submit()["queue_position"] == 1
    assert either.http.get(answer.headers["Location"]).json()["name"] == "first"
    config = either.http.get(f"/v1/jobs/{job['id']}/config").json()
    assert (config["frames"], config["seed"], config["preset"]) == (3, 7, "fast-5")


@pytest.mark.parametrize("status", ["PENDING", "ENQUEUED"])
def test_when_a_job_was_started_is_kept_as_it_is_cancelled(either: Api, status: str) -> None:
    """Of one that waits it is not known; one that is resumed has not been started again."""
    job = f"/v1/jobs/{either.submit()['id']}"
    workflows, at = either.context.queue._workflows, 1_767_225_600_000
    started = {"started_at_epoch_ms": at, "updated_at": at} if status == "PENDING" else {}
    with workflows.begin() as connection:
        connection.execute(sa.update(workflows.table).values({"status": status} | started))
    assert either.http.post(f"{job}/cancel").status_code == 202
    shown = either.http.get(job).json()
    assert shown["state"] == "cancelled"
    assert shown["started_at"] == ("2026-01-01T00:00:00Z" if started else None)
    assert either.http.post(f"{job}/resume").status_code == 202
    assert either.http.get(job).json()["started_at"] is None


def test_long_names_make_files_that_can_be_written(api: Api, cube: bytes) -> None:
    """Of several hundred letters a part is left."""
    name = f"{'long' * 48}.obj"
    mesh = api.http.post("/v1/meshes", params={"name": name}, content=cube).json()["id"]
    job = api.submit(source={"mesh": mesh}, target={"mesh": mesh})["id"]
    record = api.context.queue.get(job)
    assert record is not None
    assert len(file_stem(record).encode()) < 200
    assert len(str(default_output(name, name)).encode()) < 200


def test_a_job_through_several_shapes_counts_the_frames_of_all_legs(either: Api) -> None:
    """They and their time are as many times more; `via` is shown, and absent in plain jobs."""
    plain = either.submit(overrides=COARSE)
    via = [{"shape": "torus"}, {"shape": "heart"}]
    several = either.submit(overrides=COARSE, via=via)
    assert (plain["via"], plain["progress"]["frames"]) == ([], 3)
    assert (several["via"], several["via_names"]) == (via, ["torus", "heart"])
    assert several["progress"]["frames"] == 9
    stored = either.context.queue.get(plain["id"])
    assert stored is not None and "via" not in stored.spec.model_dump(mode="json")
    left = [job["progress"]["seconds_left"] for job in (plain, several)]
    assert left[1] > left[0]
    for fault in (
        {"via": [{"shape": "spere"}]},
        {"via": [{"mesh": "0" * 64}]},
        {"via": 33 * [{"shape": "star"}]},
        {"via": via, "overrides": {"landmarks": [{"source": [0, 0, 0], "target": [0, 0, 0]}]}},
    ):
        answer = either.http.post("/v1/jobs", json=MORPH | fault)
        assert answer.status_code == 422 and answer.json()["remedy"], (fault, answer.text)


def test_faults_of_a_request_are_found_before_it_is_queued(api: Api) -> None:
    """Unknown presets, settings, methods, shapes and meshes answer 422 with a remedy."""
    faults = [
        {"preset": "fats"},
        {"overrides": {"chamfer.wieght": 5}},
        {"method": "joint", "overrides": {"chamfer.weight": -1}},
        {"method": "joint", "overrides": {"chamfer.weight": "inf"}},
        {"method": "dco", "overrides": {"chamfer.weight": 5}},
        {"overrides": {"preset": "x"}},
        {"overrides": {"frames": 4}},
        {"method": "jiont"},
        {"source": {"shape": "spere"}},
        {"source": {"shape": "/etc/passwd"}},
        {"source": {"shape": "text:"}},
        {"source": {"mesh": "0" * 64}},
        {"source": {"mesh": "nonsense"}},
        {"frames": 0},
        {"unknown": 1},
    ]
    for fault in faults:
        answer = api.http.post("/v1/jobs", json=MORPH | fault)
        assert answer.status_code == 422 and answer.json()["remedy"], (fault, answer.text)
    for body in (b"", b"{", b'{"frames": NaN}', b"[" * 100_000, b'"\xff"', b"null"):
        answer = api.http.post(
            "/v1/jobs", content=body, headers={"Content-Type": "application/json"}
        )
        assert answer.status_code == 422, answer.text
    assert api.http.post("/v1/jobs", content=b"{}").status_code == 415
    assert not api.http.get("/v1/jobs").json()["items"]


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/sweeps", "/v1/keys"])
def test_bodies_that_are_no_json_are_refused_alike(make_api: Callable[..., Api], path: str) -> None:
    """Whatever reads them: not JSON, too deep, too large, of another type, of another shape."""
    api = make_api(body_bytes=200_000)
    kind = {"Content-Type": "application/json"}
    for body in (b"", b"{", b"[" * 100_000, b'"\xff"', b"null", b"[]", b'{"name": NaN}'):
        answer = api.http.post(path, content=body, headers=kind)
        assert answer.status_code == 422 and answer.json()["remedy"], (body[:20], answer.text)
    broken = api.http.post(path, content=b'{"name": 1,}', headers=kind).json()
    assert broken["detail"].startswith("The body is not JSON: ")
    assert api.http.post(path, content=b"{}", headers={"Content-Type": "x/y"}).status_code == 415
    assert api.http.post(path, content=b"{}").status_code == 415
    large = api.http.post(path, json={"name": "x" * 200_000})
    assert large.status_code == 413 and "200000 bytes" in large.json()["detail"]
    assert large.headers["Retry-After"]
    fault = api.http.post(path, json={"unknown": 1}).json()
    assert ["unknown"] in [error["loc"] for error in fault["errors"]]


def test_a_repeated_submit_is_one_job(either: Api) -> None:
    """The same key and body answer the same job; another body is refused."""
    headers = {"Idempotency-Key": "a b/c"}
    first = either.http.post("/v1/jobs", json=MORPH, headers=headers)
    again = either.http.post("/v1/jobs", json=MORPH, headers=headers)
    other = either.http.post("/v1/jobs", json=MORPH | {"frames": 4}, headers=headers)
    assert [first.status_code, again.status_code, other.status_code] == [202, 200, 422]
    assert first.json()["id"] == again.json()["id"]
    assert len(either.http.get("/v1/jobs?limit=100").json()["items"]) == 1


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/sweeps"])
def test_a_submit_is_repeated_after_its_mesh_has_gone(either: Api, cube: bytes, path: str) -> None:
    """Whoever has lost the answer finds what was made, although it could not be made now."""
    mesh = either.http.post("/v1/meshes?name=cube.obj", content=cube).json()["id"]
    shape, star = {"mesh": mesh}, {"shape": "star"}
    body: dict[str, Any] = {"overrides": COARSE, "frames": 3}
    body |= (
        {"sources": [shape], "targets": [star], "methods": ["joint"]}
        if path == "/v1/sweeps"
        else {"source": shape, "target": star}
    )
    headers = {"Idempotency-Key": "lost"}
    first = either.http.post(path, json=body, headers=headers)
    assert first.status_code == 202, first.text
    for job in either.http.get("/v1/jobs").json()["items"]:
        assert either.http.post(f"/v1/jobs/{job['id']}/cancel").status_code == 202
    assert either.http.delete(f"/v1/meshes/{mesh}").status_code == 204
    again = either.http.post(path, json=body, headers=headers)
    assert again.status_code == 200 and again.json()["id"] == first.json()["id"]
    other = either.http.post(path, json=body | {"frames": 4}, headers=headers)
    assert other.status_code == 422 and "Idempotency-Key" in other.json()["detail"]


def test_jobs_are_listed_by_state_method_and_page(either: Api) -> None:
    """Filters and cursors show each job once, the newest first."""
    name = "listed"
    ids = [either.submit(name=name, method=method)["id"] for method in ("joint", "physics") * 2]
    either.http.post(f"/v1/jobs/{ids[0]}/cancel")
    seen, cursor = [], None
    while cursor is not None or not seen:
        query = {"limit": 3} | ({"cursor": cursor} if cursor else {})
        page = either.http.get("/v1/jobs", params=query).json()
        seen += [job["id"] for job in page["items"] if job["name"] == name]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert seen == ids[::-1]
    cancelled = either.http.get("/v1/jobs?state=cancelled").json()["items"]
    assert ids[0] in [job["id"] for job in cancelled]
    physics = either.http.get("/v1/jobs?method=physics&state=queued&state=running").json()["items"]
    assert [job["id"] for job in physics if job["name"] == name] == [ids[3], ids[1]]
    assert either.http.get("/v1/jobs?cursor=nonsense").status_code == 422


def test_what_may_be_done_with_a_job_depends_on_its_state(either: Api) -> None:
    """Cancel, resume, retry and delete each work where they make sense and answer 409 elsewhere."""
    path = f"/v1/jobs/{either.submit()['id']}"
    for action in ("resume", "retry"):
        assert either.http.post(f"{path}/{action}").status_code == 409
    assert either.http.delete(path).status_code == 409
    assert either.http.get(f"{path}/result").status_code == 409
    assert either.http.post(f"{path}/cancel").json()["state"] == "cancelled"
    assert either.http.post(f"{path}/cancel").status_code == 202, "a repeated cancel is no fault"
    for action in ("resume", "retry"):
        answer = either.http.post(f"{path}/{action}")
        assert (answer.status_code, answer.json()["state"]) == (202, "queued"), answer.text
        either.http.post(f"{path}/cancel")
    assert either.http.delete(path).status_code == 204
    for answer in (either.http.get(path), either.http.delete(path)):
        assert answer.status_code == 404


def test_overrides_of_a_sweep_go_to_the_methods_that_have_them(api: Api) -> None:
    """One that a single method has is no fault; one that none of them has is."""
    body = {
        "sources": [{"shape": "sphere"}],
        "targets": [{"shape": "star"}],
        "methods": ["joint", "transport"],
        "overrides": {"chamfer.weight": 5, "sweeps": 3, "frames": 7},
    }
    rows = api.http.post("/v1/sweeps", json=body).json()["rows"]
    configs = {row["method"]: api.http.get(f"/v1/jobs/{row['job']}/config").json() for row in rows}
    assert configs["joint"]["method"]["chamfer"]["weight"] == 5
    assert configs["transport"]["method"]["sweeps"] == 3
    assert {config["frames"] for config in configs.values()} == {7}
    for row in rows:
        api.http.post(f"/v1/jobs/{row['job']}/cancel")
    refused = api.http.post("/v1/sweeps", json={**body, "overrides": {"basis.cells": 5}})
    assert refused.status_code == 422 and "shared_basis" in refused.json()["remedy"]


def test_a_sweep_is_every_combination_and_one_table(either: Api) -> None:
    """Sources x targets x methods x seeds become jobs, once, however often it is sent."""
    body = {
        "sources": [{"shape": "sphere"}],
        "targets": [{"shape": "star"}, {"shape": "torus"}],
        "methods": ["joint", "physics"],
        "seeds": [1, 2],
        "frames": 3,
        "name": "all",
    }
    headers = {"Idempotency-Key": "sweep"}
    answer = either.http.post("/v1/sweeps", json=body, headers=headers)
    sweep = answer.json()
    assert answer.status_code == 202, answer.text
    rows = [(row["target"], row["method"], row["seed"]) for row in sweep["rows"]]
    assert rows == list(product(("star", "torus"), ("joint", "physics"), (1, 2)))
    assert sweep["counts"]["queued"] == 8
    again = either.http.post("/v1/sweeps", json=body, headers=headers)
    assert again.status_code == 200 and again.json() == sweep
    other = either.http.post("/v1/sweeps", json=body | {"seeds": [3]}, headers=headers)
    assert other.status_code == 422
    table = either.http.get(answer.headers["Location"], params={"format": "csv"}).text
    assert table.splitlines()[0] == "job,source,target,method,seed,state"
    assert len(table.splitlines()) == 9
    listed = either.http.get("/v1/jobs", params={"sweep": sweep["id"]}).json()["items"]
    assert {job["id"] for job in listed} == {row["job"] for row in sweep["rows"]}


def test_a_sweep_with_a_fault_makes_no_job(api: Api) -> None:
    """All of it is checked first."""
    body = {"sources": [{"shape": "sphere"}], "targets": [{"shape": "star"}, {"shape": "no"}]}
    assert api.http.post("/v1/sweeps", json=body).status_code == 422
    many = {"sources": [{"shape": "sphere"}], "targets": [{"shape": "star"}], "seeds": [1] * 100}
    many |= {"methods": ["joint"] * 20}
    assert api.http.post("/v1/sweeps", json=many).status_code == 422
    endless = (
        b'{"sources":[{"shape":"sphere"}],"targets":[{"shape":"star"}],"timeout_seconds":Infinity}'
    )
    kind = {"Content-Type": "application/json"}
    assert api.http.post("/v1/sweeps", content=endless, headers=kind).status_code == 422
    assert not api.http.get("/v1/jobs").json()["items"]


def test_limits_are_answered_with_a_time_to_retry(
    make_api: Callable[..., Api], cube: bytes
) -> None:
    """Too many jobs or meshes are 429, a full disk is 413."""
    api = make_api(queued_jobs_per_key=2, meshes_per_key=1)
    api.submit(), api.submit()
    too_many = api.http.post("/v1/jobs", json=MORPH)
    api.http.post("/v1/meshes?name=a.obj", content=cube)
    one_more = api.http.post("/v1/meshes?name=b.obj", content=cube + b"#\n")
    for answer in (too_many, one_more):
        assert answer.status_code == 429 and int(answer.headers["Retry-After"]) > 0
    api = make_api(disk_bytes_per_key=len(cube))
    assert api.http.post("/v1/meshes?name=a.obj", content=cube).status_code == 201
    api.context.quotas.invalidate("")
    assert api.http.post("/v1/jobs", json=MORPH).status_code == 413


def test_frames_and_metrics_are_there_while_the_job_runs(api: Api) -> None:
    """Every encoding holds the positions of the run directory; metrics come from the events."""
    job = api.submit(overrides={"sampling.points_per_cell_edge": 2})
    result = api.context.storage.result_path(job["id"])
    result.parent.mkdir()
    config = configure("fast", {"sampling.points_per_cell_edge": 2, "frames": 3})
    run = prepare("sphere", "star", config)
    log = api.context.storage.events(job["id"])
    with Spool.create(result, run) as spool:
        for index in range(2):
            spool.append(index, run.source_points + index, {"two_sided": index})
            data = {"frame": index, "frames": 3, "attempt": 1, "metrics": {"two_sided": index}}
            log.append("frame", data | {"seconds": 2.0})
    path = f"/v1/jobs/{job['id']}"
    wanted = run.source_points + 1
    plain = api.http.get(f"{path}/frames/-1")
    assert plain.headers["Morph-Frame"] == "1"
    np.testing.assert_array_equal(np.frombuffer(plain.content, "<f4").reshape(-1, 3), wanted)
    levels = api.http.get(f"{path}/frames/1?format=u16")
    offset, scale = (float(levels.headers[f"Morph-{name}"]) for name in ("Offset", "Scale"))
    positions = offset + scale * np.frombuffer(levels.content, "<u2").reshape(-1, 3)
    np.testing.assert_allclose(positions, wanted, atol=scale / 2 + 1e-6)  # half a level
    npy = api.http.get(f"{path}/frames/1?format=npy").content
    np.testing.assert_array_equal(np.frombuffer(npy[128:], "<f4").reshape(-1, 3), wanted)
    ply = api.http.get(f"{path}/frames/1?format=ply").content
    assert ply.startswith(b"ply\n") and ply.endswith(wanted.astype("<f4").tobytes())
    known = {"If-None-Match": plain.headers["ETag"]}
    assert api.http.get(f"{path}/frames/1", headers=known).status_code == 304
    assert api.http.get(f"{path}/frames/2").status_code == 404
    assert [row["two_sided"] for row in api.http.get(f"{path}/metrics").json()] == [0, 1]
    assert api.http.get(f"{path}/metrics?format=csv").text.split() == [
        "frame,two_sided,seconds", "0,0,2.0", "1,1,2.0",
    ]  # fmt: skip
    progress = api.http.get(path).json()["progress"]
    assert (progress["frame"], progress["metrics"]) == (2, {"two_sided": 1})
    assert api.http.get(f"{path}/log").text == ""


def test_the_catalog_names_what_there_is(api: Api) -> None:
    """Presets with their settings, methods, shapes and the schema of the configuration."""
    presets = api.http.get("/v1/presets").json()
    assert presets[0]["name"] == "fast"
    assert api.http.get("/v1/presets/paper").json()["config"]["preset"] == "paper-2"
    assert api.http.get("/v1/presets/none").status_code == 404
    of_joint = api.http.get("/v1/presets/fast?method=joint").json()["config"]["method"]
    assert (of_joint["name"], of_joint["material"]["drag"]) == ("joint", 4.0)
    assert api.http.get("/v1/presets/fast?method=none").status_code == 422
    assert {"joint", "physics"} <= {m["name"] for m in api.http.get("/v1/methods").json()}
    assert all(method["description"] for method in api.http.get("/v1/methods").json())
    assert {"sphere", "text:WORD"} <= {s["name"] for s in api.http.get("/v1/shapes").json()}
    schema = api.http.get("/v1/schemas/config").json()
    assert "joint" in schema["properties"]["method"]["discriminator"]["mapping"]
    json.dumps(schema)


def test_api_worker_and_janitor_never_load_taichi(api: Api) -> None:
    """It costs a second and memory, and only engine processes need it."""
    code = (
        "import sys; from chamfer_morph.server import app, api_server; "
        "from chamfer_morph.worker import workflow, janitor; "
        "sys.exit('taichi' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert api.http.get("/v1/methods").status_code == 200
