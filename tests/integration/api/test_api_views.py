"""What the page draws besides frames: both ends of a morph, fields, previews of shapes."""

from __future__ import annotations

import io
import json
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
import trimesh
from PIL import Image

from chamfer_morph.client import MorphClient
from morph_engine import configure, srgb
from morph_engine.geometry.mesh import load_mesh
from morph_engine.morphing import prepare
from morph_engine.results.fields import FIELDS
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import write_result
from tests.integration.api.conftest import COARSE, CUBE, Api, halted_child
from tests.patience import until


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


def test_the_shapes_of_each_leg(api: Api) -> None:
    """A leg names its target; a field that looks at the target looks at that of the frame's leg."""
    run = prepare("sphere", ["torus", "star"], configure("fast", COARSE | {"frames": 1}))
    job = api.submit(overrides=COARSE, via=[{"shape": "torus"}], frames=1)["id"]
    result = api.context.storage.result_path(job)
    result.parent.mkdir()
    with Spool.create(result, run) as spool:
        for leg in (0, 1):
            spool.append(leg, run.source_points, {}, leg=leg)
    for query, leg in (("", 1), ("?leg=0", 0), ("?leg=1", 1)):
        answer = api.http.get(f"/v1/jobs/{job}/target{query}")
        assert answer.headers["Morph-Particles"] == str(len(run.target_points_of(leg)))
    assert api.http.get(f"/v1/jobs/{job}/target/mesh?leg=2").status_code == 404
    distances = [
        api.http.get(f"/v1/jobs/{job}/frames/{leg}/fields/target_distance?format=f32").content
        for leg in (0, 1)
    ]
    assert distances[0] != distances[1]


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


def test_previews_of_meshes_and_shapes(
    api: Api, cube: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The particles of a shape before any job, with what to know of it."""
    answer = api.http.get("/v1/shapes/sphere/particles?points_per_cell_edge=2")
    assert answer.status_code == 200, answer.text
    positions = decoded(answer)
    wanted = prepare("sphere", "star", configure("fast", COARSE)).source_points
    np.testing.assert_allclose(positions, wanted, atol=3e-4)
    assert answer.headers["Morph-Count"] == str(len(wanted))
    assert json.loads(answer.headers["Morph-Warnings"]) == []
    with monkeypatch.context() as away:
        away.setenv("HOME", str(tmp_path / "home"))  # where Matplotlib has no list of fonts yet
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
        child = halted_child("sample_shape")
        url = api.http.base_url
        with socket.create_connection((url.host, url.port or 80)) as plain:
            plain.sendall(f"GET {path}6 HTTP/1.1\r\nHost: {url.host}\r\n\r\n".encode())
            until(lambda: len(previews._flights) == 2)
        child.resume()
        assert first.result().status_code == 200
    assert api.http.get(f"{path}2").status_code == 200
    assert {points_per_cell_edge for _, points_per_cell_edge, *_ in previews._cache} == {5, 2}


def test_colours_of_a_job(
    api: Api, run: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A byte each for red, green and blue, in both shapes; none where no shape has colours.

    A surface has them once the job has ended, though it was asked for before. While the job runs
    the process of the API looks up none itself, for that holds up all else.
    """
    path = tmp_path / "ball.ply"
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5)
    directions = ball.vertices / 5
    ball.visual = trimesh.visual.ColorVisuals(
        ball, vertex_colors=np.rint(127 * (directions + 1)).astype(np.uint8)
    )
    ball.export(path)
    colored = prepare(load_mesh(path), "sphere", configure("fast", COARSE | {"frames": 3}))
    job = api.running(colored)
    outward = colored.source_points / np.linalg.norm(colored.source_points, axis=1)[:, None]
    outer = np.linalg.norm(colored.source_points, axis=1) > 2
    monkeypatch.delattr("morph_engine.results.colors.particle_colors")
    for ended in (False, True):
        if ended:
            monkeypatch.undo()
            assert api.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
            result = api.context.storage.result_path(job)
            with Spool.open(result, writable=False) as spool:
                write_result(spool, status="partial")
        answer = api.http.get(f"/v1/jobs/{job}/colors")
        assert answer.headers["Morph-Reached"] == "0,3"
        found = np.frombuffer(answer.content, np.uint8).reshape(2, -1, 3)
        assert np.abs(found[0] - 127 * (outward + 1.0))[outer].mean() < 10
        assert np.abs(found[1] - 255 * np.array(srgb.CLAY)).max() < 1
        known = {"If-None-Match": answer.headers["ETag"]}
        assert api.http.get(f"/v1/jobs/{job}/colors", headers=known).status_code == 304
        with MorphClient(str(api.http.base_url)) as client:
            assert np.array_equal(client.colors(job), found)
        drawn = Image.open(io.BytesIO(api.http.get(f"/v1/jobs/{job}/thumbnail").content))
        pixels = np.asarray(drawn.convert("RGBA"), float)
        red, green, _, cover = np.moveaxis(pixels[pixels[..., 3] > 250], -1, 0)
        assert cover.size > 1000 and np.abs(red - green).max() > 20  # clay has 10
        surface = f"/v1/jobs/{job}/frames/1/surface"
        ply = api.http.get(surface, params={"format": "ply"}).content
        mesh = trimesh.load_mesh(trimesh.util.wrap_as_stream(ply), file_type="ply")
        assert (mesh.visual.kind == "vertex") == ended
        assert (b"COLOR_0" in api.http.get(surface).content) == ended
    plain = api.http.get(f"/v1/jobs/{api.running(run)}/colors")
    assert (plain.content, plain.headers["Morph-Shapes"]) == (b"", "0")
    assert api.http.get(f"/v1/jobs/{api.submit()['id']}/colors").status_code == 404


def test_a_posed_shape_in_previews_and_jobs(api: Api) -> None:
    """An STL, which has z up, beside a sphere: turned, also as asked, and told how to come back."""
    box = trimesh.creation.box((6.0, 8.0, 12.0))
    box.apply_translation((100.0, 0.0, 0.0))
    mesh = api.http.post("/v1/meshes?name=box.stl", content=box.export(file_type="stl")).json()
    assert mesh["report"]["up"] == "z"
    query: dict[str, Any] = {"points_per_cell_edge": 2, "source": "sphere", "format": "f32"}
    answer = api.http.get(f"/v1/meshes/{mesh['id']}/particles", params=query)
    extent = np.ptp(np.frombuffer(answer.content, "<f4").reshape(-1, 3), axis=0)
    assert extent.argmax() == 1 and answer.headers["Morph-Up"] == "y"
    assert "The target is rotated by 90 degrees" in answer.headers["Morph-Turning"]

    pose = {"target": {"rotate": [0, 0, 90], "move": [0, 1, 0]}}
    query["placement"] = json.dumps(pose)
    answer = api.http.get(f"/v1/meshes/{mesh['id']}/particles", params=query)
    points = np.frombuffer(answer.content, "<f4").reshape(-1, 3)
    assert np.ptp(points, axis=0).argmax() == 0 and abs(points[:, 1].mean() - 1) < 0.1
    to_user = np.array(json.loads(answer.headers["Morph-To-User"]))
    back = points @ to_user[:3, :3].T + to_user[:3, 3]
    slack = 0.6 * to_user[0:3, 0:3].max()  # a spacing of half a grid unit
    assert (back >= box.bounds[0] - slack).all() and (back <= box.bounds[1] + slack).all()
    query["placement"] = '{"target": {"rotate": 3}}'
    assert api.http.get(f"/v1/meshes/{mesh['id']}/particles", params=query).status_code == 422

    overrides = COARSE | {"placement.target.rotate": [0, 0, 90], "placement.target.move": [0, 1, 0]}
    job = api.submit(target={"mesh": mesh["id"]}, overrides=overrides)
    assert job["placement"]["up"] == "y"
    np.testing.assert_allclose(np.linalg.inv(job["placement"]["target"]), to_user, atol=1e-9)
    config = api.http.get(f"/v1/jobs/{job['id']}/config").json()
    assert config["placement"]["target"]["rotate"] == [0, 0, 90]
    beyond = {"placement.target.move": [15, 0, 0]}
    body = {"source": {"shape": "sphere"}, "target": {"mesh": mesh["id"]}, "overrides": beyond}
    refused = api.http.post("/v1/jobs", json=body)
    assert refused.status_code == 422 and "move it less" in refused.json()["remedy"]
