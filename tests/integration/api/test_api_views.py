"""What the page draws besides frames: both ends of a morph, fields, previews of shapes."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import numpy as np
import pytest
import trimesh

from morph_engine import configure
from morph_engine.morphing import prepare
from morph_engine.results.fields import FIELDS
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import COARSE, CUBE, Api


def decoded(answer: Any) -> np.ndarray:
    """Positions of u16."""
    offset, scale = (float(answer.headers[f"Morph-{name}"]) for name in ("Offset", "Scale"))
    return offset + scale * np.frombuffer(answer.content, "<u2").reshape(-1, 3)


def test_both_ends_of_a_morph(api: Api, run: RunRecord) -> None:
    """Points as frames are encoded, meshes in grid units; nothing before the job has begun."""
    path = f"/v1/jobs/{api.running(run)}"
    for end, points in (("source", run.source_points), ("target", run.target_points)):
        answer = api.http.get(f"{path}/{end}?format=u16")
        assert answer.headers["Morph-Particles"] == str(len(points))
        np.testing.assert_allclose(decoded(answer), points, atol=3e-4)  # half a level
        known = {"If-None-Match": answer.headers["ETag"]}
        assert api.http.get(f"{path}/{end}?format=u16", headers=known).status_code == 304
        for format in ("glb", "ply"):
            file = api.http.get(f"{path}/{end}/mesh?format={format}")
            assert file.status_code == 200, file.text
            mesh = trimesh.load_mesh(trimesh.util.wrap_as_stream(file.content), file_type=format)
            wanted = getattr(run, end).bounds
            np.testing.assert_allclose(mesh.bounds, wanted, atol=1e-5)  # float32
    waiting = api.submit()["id"]
    for end in ("source", "target", "source/mesh", "target/mesh"):
        answer = api.http.get(f"/v1/jobs/{waiting}/{end}")
        assert answer.status_code == 404 and answer.json()["remedy"]


def test_fields_of_a_frame(api: Api, run: RunRecord) -> None:
    """Values as float32 and as bytes over a range; what is unknown is a problem."""
    listed = {field["name"]: field for field in api.http.get("/v1/fields").json()}
    assert listed.keys() == FIELDS.keys() and all(field["label"] for field in listed.values())
    path = f"/v1/jobs/{api.running(run)}/frames"
    expected = {("displacement", 0): 1, ("displacement", 1): 3, ("speed", 0): 1, ("speed", -1): 2}
    for (name, frame), value in expected.items():
        answer = api.http.get(f"{path}/{frame}/fields/{name}?format=f32")
        assert answer.headers["Morph-Frame"] == str(frame % 2)
        np.testing.assert_allclose(np.frombuffer(answer.content, "<f4"), value, rtol=1e-5)
    exact = np.frombuffer(
        api.http.get(f"{path}/1/fields/target_distance?format=f32").content, "<f4"
    )
    own = api.http.get(f"{path}/1/fields/target_distance")
    low, high = float(own.headers["Morph-Low"]), float(own.headers["Morph-High"])
    assert (low, high) == pytest.approx((exact.min(), exact.max()))
    offset, scale = (float(own.headers[f"Morph-{name}"]) for name in ("Offset", "Scale"))
    values = offset + scale * np.frombuffer(own.content, np.uint8)
    np.testing.assert_allclose(values, exact, atol=scale / 2 + 1e-6)  # half a level
    clamped = api.http.get(f"{path}/1/fields/target_distance?low=1&high=2").content
    levels = np.frombuffer(clamped, np.uint8)
    assert (levels[exact <= 1] == 0).all() and (levels[exact >= 2] == 255).all()
    known = {"If-None-Match": own.headers["ETag"]}
    path_of_own = f"{path}/1/fields/target_distance"
    assert api.http.get(path_of_own, headers=known).status_code == 304
    assert api.http.get(f"{path_of_own}?high=2", headers=known).status_code == 200
    refused = {"fields/colour": 404, "fields/speed?low=2&high=1": 422, "fields/det_f": 422}
    for query, status in refused.items():
        answer = api.http.get(f"{path}/1/{query}")
        assert answer.status_code == status and answer.json()["remedy"], query
    assert api.http.get(f"{path}/2/fields/speed").status_code == 404


def test_previews_of_meshes_and_shapes(api: Api, cube: bytes, tmp_path: Path) -> None:
    """The particles of a shape before any job, with what to know of it."""
    answer = api.http.get("/v1/shapes/sphere/particles?points_per_cell_edge=2")
    assert answer.status_code == 200, answer.text
    positions = decoded(answer)
    wanted = prepare("sphere", "star", configure("fast", COARSE)).source_points
    np.testing.assert_allclose(positions, wanted, atol=3e-4)
    assert answer.headers["Morph-Count"] == str(len(wanted))
    assert json.loads(answer.headers["Morph-Warnings"]) == []
    text = api.http.get("/v1/shapes/text%3AA%2FB/particles?points_per_cell_edge=2")
    assert text.status_code == 200 and int(text.headers["Morph-Count"]) > 500
    mesh = api.http.post("/v1/meshes?name=cube.obj", content=cube).json()["id"]
    answer = api.http.get(f"/v1/meshes/{mesh}/particles?points_per_cell_edge=1&format=f32")
    assert int(answer.headers["Morph-Count"]) == len(answer.content) // 12 > 500
    large = cube.replace(b"10", b"1000")
    mesh = api.http.post("/v1/meshes?name=large.obj", content=large).json()["id"]
    answer = api.http.get(f"/v1/meshes/{mesh}/particles?points_per_cell_edge=2")
    assert "scaled" in answer.headers["Morph-Placement"] and np.abs(decoded(answer)).max() < 14
    beside = api.http.get(f"/v1/meshes/{mesh}/particles?source=sphere&points_per_cell_edge=2")
    assert beside.headers["Morph-Placement"].startswith("The target is scaled by")
    own = api.http.get(f"/v1/shapes/sphere/particles?target={mesh}&points_per_cell_edge=2")
    assert own.headers["Morph-Placement"] == beside.headers["Morph-Placement"]
    wanted = prepare("sphere", "star", configure("fast", COARSE)).source_points
    np.testing.assert_allclose(decoded(own), wanted, atol=3e-4)
    for query in ("source=spere", f"target={'0' * 64}", "source=star&target=star"):
        answer = api.http.get(f"/v1/meshes/{mesh}/particles?{query}")
        assert answer.status_code == 422 and answer.json()["remedy"]
    refused = api.http.get(f"/v1/meshes/{mesh}/particles?fit=none")
    assert refused.status_code == 422 and "volume" in refused.json()["remedy"]
    secret = tmp_path / "secret.obj"
    secret.write_text(CUBE)
    for path in (
        "shapes/spere/particles",
        "shapes/text:/particles",
        "shapes/text:A%00/particles",
        f"shapes/{secret}/particles",
        f"shapes/{quote(str(secret), safe='')}/particles",
    ):
        answer = api.http.get(f"/v1/{path}")
        assert answer.status_code == 422 and answer.json()["remedy"]
    assert api.http.get(f"/v1/meshes/{'0' * 64}/particles").status_code == 404


def test_a_preview_that_nobody_waits_for_is_not_computed(api: Api) -> None:
    """Who leaves while another preview is under way costs nothing."""
    path, previews = "/v1/shapes/star/particles?points_per_cell_edge=", api.context.previews
    with ThreadPoolExecutor() as pool:
        first = pool.submit(api.http.get, f"{path}5")
        while not previews._flights:
            assert not first.done()
        with pytest.raises(httpx.ReadTimeout):
            api.http.get(f"{path}6", timeout=0.3)
        assert first.result().status_code == 200
    assert api.http.get(f"{path}2").status_code == 200
    assert {points_per_cell_edge for _, points_per_cell_edge, *_ in previews._cache} == {5, 2}
