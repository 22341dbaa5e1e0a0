"""What is computed from frames on request: surfaces, thumbnails, exports."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import trimesh
from PIL import Image

from chamfer_morph.client import MorphClient
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.schemas import PictureOptions
from chamfer_morph.server.routes import exports
from chamfer_morph.worker.sandbox import runner
from morph_engine.export import FORMATS
from morph_engine.geometry.surface_reconstruction import Surface, surface_deviation
from morph_engine.morphing import prepare
from morph_engine.presets import configure
from morph_engine.rendering.materials import MATERIALS
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import COARSE, Api, halted_child
from tests.patience import PATIENCE, until


def loaded(content: bytes, format: str) -> trimesh.Trimesh:
    """A mesh file as trimesh reads it, equal vertices made one."""
    mesh = trimesh.load_mesh(io.BytesIO(content), file_type=format)
    mesh.merge_vertices(merge_norm=True)
    return mesh


def ready(api: Api, location: str) -> dict[str, Any]:
    """An export once it has ended."""
    until(lambda: api.http.get(location).json()["state"] != "running")
    export: dict[str, Any] = api.http.get(location).json()
    return export


def test_the_surface_of_a_frame(api: Api, run: RunRecord, monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed, in every format and unit, computed once for all who ask, and kept."""
    started = []

    def counted(*arguments: Any, **options: Any) -> runner.Answer:
        started.append(arguments[0])
        return limited_run(*arguments, **options)

    limited_run = runner.run
    monkeypatch.setattr(runner, "run", counted)
    path = f"/v1/jobs/{api.running(run)}/frames/0/surface"
    with ThreadPoolExecutor(3) as pool:
        answers = list(pool.map(api.http.get, [path] * 3))
    assert [answer.status_code for answer in answers] == [200] * 3, answers[0].text
    headers = answers[0].headers
    assert headers["Morph-Watertight"] == "true" and headers["Morph-Bodies"] == "1"
    assert 0 < float(headers["Morph-Deviation-Mean"]) < float(headers["Morph-Deviation-Max"])
    meshes = {"glb": loaded(answers[0].content, "glb")}
    for format in ("ply", "obj", "stl"):
        answer = api.http.get(path, params={"format": format, "units": "user"})
        meshes[format] = loaded(answer.content, format)
    for mesh in meshes.values():  # a built-in shape's own units are grid units
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(1394, rel=0.03)  # that of the sphere
        np.testing.assert_allclose(mesh.bounds.mean(axis=0), [1, 0, 0], atol=0.1)
    assert started == ["chamfer_morph.worker.tasks.reconstruct_surface"]
    known = {"If-None-Match": headers["ETag"]}
    assert api.http.get(path, headers=known).status_code == 304
    assert api.http.get(path.replace("/0/", "/2/")).status_code == 404


def test_a_surface_is_snapped_to_a_mesh(api: Api) -> None:
    """Once the job has ended: the same triangles, nearer to the source, and measured as before."""
    run = prepare("sphere", "star", configure("fast", COARSE | {"frames": 20}))
    mesh, _ = run.fitted("source")

    def surfaces(job: str) -> list[tuple[httpx.Response, Surface]]:
        found = []
        for snap in (False, True):
            query = {"format": "ply", "snap": snap}
            answer = api.http.get(f"/v1/jobs/{job}/frames/0/surface", params=query)
            assert answer.status_code == 200, answer.text
            ply = trimesh.load_mesh(io.BytesIO(answer.content), file_type="ply", process=False)
            found.append((answer, Surface(np.array(ply.vertices), np.array(ply.faces))))
        return found

    (_, plain), (_, snapped) = surfaces(api.running(run))
    np.testing.assert_array_equal(snapped.vertices, plain.vertices)
    (first, plain), (second, snapped) = surfaces(api.finished(run))
    np.testing.assert_array_equal(snapped.faces, plain.faces)
    far, near = (surface_deviation(one, mesh)["mean"] for one in (plain, snapped))
    assert near < 0.95 * far
    assert first.headers["ETag"] != second.headers["ETag"]
    assert first.headers["Morph-Deviation-Mean"] == second.headers["Morph-Deviation-Mean"]


def test_a_surface_that_takes_too_much_is_refused(
    make_api: Callable[..., Api], run: RunRecord
) -> None:
    """The limit is named, and nothing is left behind."""
    api = make_api(export_memory_bytes=4 << 20)
    job = api.running(run)
    answer = api.http.get(f"/v1/jobs/{job}/frames/0/surface")
    assert answer.status_code == 422 and "4 MiB" in answer.json()["detail"], answer.text
    assert not list(api.context.storage.derived_dir(job).glob("surface*"))


def test_a_thumbnail_of_the_newest_frame(api: Api, run: RunRecord) -> None:
    """A small picture, drawn once for each number of frames."""
    job = api.running(run)
    answer = api.http.get(f"/v1/jobs/{job}/thumbnail")
    assert answer.status_code == 200 and answer.headers["content-type"] == "image/webp"
    assert Image.open(io.BytesIO(answer.content)).size == (240, 180)
    known = {"If-None-Match": answer.headers["ETag"]}
    assert api.http.get(f"/v1/jobs/{job}/thumbnail", headers=known).status_code == 304
    assert [p.name for p in api.context.storage.derived_dir(job).glob("*.webp")] == [
        "thumbnail-000002.webp"
    ]
    waiting = api.submit()["id"]
    assert api.http.get(f"/v1/jobs/{waiting}/thumbnail").status_code == 404


def test_exports_are_made_once_and_kept(
    make_api: Callable[..., Api], run: RunRecord, tmp_path: Path
) -> None:
    """From the request to the file, which outlives the service and goes with the job."""
    data = tmp_path / "data"
    api = make_api(data_dir=data)
    formats = {format["name"]: format for format in api.http.get("/v1/exports/formats").json()}
    assert formats["ply"]["kind"] == "frame" and "points" in formats["ply"]["carries"]
    job = api.finished(run)
    path = f"/v1/jobs/{job}/exports"
    body = {"format": "ply", "units": "grid", "fields": ["displacement"]}
    asked = api.http.post(path, json=body)
    assert asked.status_code == 202, asked.text
    again = api.http.post(path, json=body | {"frames": None})
    assert again.json()["id"] == asked.json()["id"]
    export = ready(api, asked.headers["Location"])
    assert (export["state"], export["progress"], export["problem"]) == ("ready", 1, None)
    file = api.http.get(export["links"]["file"])
    assert len(file.content) == export["size"]
    assert hashlib.sha256(file.content).hexdigest() == file.headers["ETag"].strip('"')
    assert 'filename="sphere-to-star-partial.zip"' in file.headers["Content-Disposition"]
    with zipfile.ZipFile(io.BytesIO(file.content)) as archive:
        assert len(archive.namelist()) == 2
        cloud = trimesh.load(io.BytesIO(archive.read(archive.namelist()[1])), file_type="ply")
        moved = run.source_points + np.float32([3, 0, 0])
        np.testing.assert_allclose(cloud.vertices, moved, atol=1e-5)
    part = api.http.get(export["links"]["file"], headers={"Range": "bytes=0-3"})
    assert part.status_code == 206 and part.content == b"PK\x03\x04"
    surface = {"format": "glb", "frames": [-1], "surface": True}
    export = ready(api, api.http.post(path, json=surface).headers["Location"])
    mesh = loaded(api.http.get(export["links"]["file"]).content, "glb")
    assert mesh.is_watertight and export["file_name"] == "sphere-to-star-partial-1.glb"
    drawn = api.http.post(path, json=surface | {"snap": True})
    assert drawn.status_code == 202 and drawn.json()["id"] != export["id"]
    assert ready(api, drawn.headers["Location"])["state"] == "ready"
    moving = api.http.post(path, json={"format": "glb", "tracked": True, "fps": 30})
    moving = ready(api, moving.headers["Location"])
    assert moving["file_name"] == "sphere-to-star-partial.glb"
    assert b'"animations"' in api.http.get(moving["links"]["file"]).content
    film = {"format": "png", "seconds": 0.5, "fps": 4, "easing": "linear", "repeat": "ping-pong"}
    film = ready(api, api.http.post(path, json=film).headers["Location"])
    assert film["file_name"] == "sphere-to-star-partial.zip", film
    with zipfile.ZipFile(io.BytesIO(api.http.get(film["links"]["file"]).content)) as archive:
        assert archive.namelist() == ["frame-0000.png", "frame-0001.png"]
    picture = {
        "width": 320, "height": 200, "look": "porcelain", "background": "transparent",
        "camera_keys": [{"share": 0, "azimuth": 0}, {"share": 1, "azimuth": 90, "zoom": 2}],
    }  # fmt: skip
    drawn = api.http.post(path, json={"format": "png", "frames": [0, 1], "picture": picture})
    drawn = ready(api, drawn.headers["Location"])
    with zipfile.ZipFile(io.BytesIO(api.http.get(drawn["links"]["file"]).content)) as archive:
        pictures = [Image.open(io.BytesIO(archive.read(name))) for name in archive.namelist()]
    assert {(one.size, one.mode) for one in pictures} == {((320, 200), "RGBA")}
    smaller, larger = (np.count_nonzero(np.asarray(pictures[at])[..., 3]) for at in (0, -1))
    assert larger > 1.5 * smaller
    table = ready(api, api.http.post(path, json={"format": "csv"}).headers["Location"])
    rows = api.http.get(table["links"]["file"]).text.split()
    assert rows == ["frame,s2t", "0,1.0", "1,3.0"]
    assert api.context.storage.job_bytes(job) > export["size"]

    later = make_api(data_dir=data)
    assert later.http.post(path, json=surface).status_code == 200
    unknown = later.http.get(f"{path}/{'0' * 26}")
    assert unknown.status_code == 404 and "POST" in unknown.json()["remedy"]
    assert later.http.delete(f"/v1/jobs/{job}").status_code == 204
    assert later.http.get(export["links"]["file"]).status_code == 404
    assert not list((data / "jobs").iterdir())


def test_exports_that_cannot_be_made(make_api: Callable[..., Api], run: RunRecord) -> None:
    """Faults of the request are found at once, others are told by the export."""
    api = make_api(export_memory_bytes=4 << 20)
    job = api.finished(run)
    path = f"/v1/jobs/{job}/exports"
    for fault in (
        {"format": "plx"},
        {"format": "ply", "frames": [2]},
        {"format": "ply", "frames": []},
        {"format": "ply", "fields": ["colour"]},
        {"format": "stl"},
        {"format": "ply", "snap": True},
        {"format": "ply", "tracked": True},
        {"format": "ply", "units": "miles"},
        {"format": "ply", "seconds": 1},
        {"format": "gif", "seconds": 1, "frames": [0]},
        {"format": "gif", "easing": "bounce"},
        {"format": "gif", "picture": {"width": 321}},
        {"format": "gif", "picture": {"background": "blakc"}},
        {"format": "gif", "picture": {"background": "transparent"}},
        {"format": "gif", "picture": {"camera_keys": [{"share": 0}, {"share": 0}]}},
        {"format": "ply", "picture": {"look": "clay"}},
        {"colour": 1},
    ):
        answer = api.http.post(path, json=fault)
        assert answer.status_code == 422 and answer.json()["remedy"], (fault, answer.text)
    running = api.submit()["id"]
    assert api.http.post(f"/v1/jobs/{running}/exports", json={"format": "ply"}).status_code == 409
    asked = api.http.post(path, json={"format": "obj", "surface": True})
    export = ready(api, asked.headers["Location"])
    assert export["state"] == "failed" and export["problem"]["kind"] == "resources"
    file = api.http.get(f"{asked.headers['Location']}/file")
    assert file.status_code == 409 and file.json()["detail"] == export["problem"]["cause"]
    assert api.http.post(path, json={"format": "obj", "surface": True}).status_code == 202


def test_an_export_can_be_deleted(api: Api, run: RunRecord) -> None:
    """With its file, and what killed ones have left behind goes with the next."""
    job = api.finished(run)
    folder = api.context.storage.exports_dir(job)
    path = f"/v1/jobs/{job}/exports"
    location = api.http.post(path, json={"format": "csv"}).headers["Location"]
    first = ready(api, location)
    (folder / "tmpabc").mkdir()
    (folder / "tmpabc" / "part.ply").write_text("ply")
    (folder / f"{'0' * 26}.zip.tmp").write_text("PK")
    npz = api.http.post(path, json={"format": "npz"}).headers["Location"]
    second = ready(api, npz)
    ids = {first["id"], second["id"]}
    assert {entry.name.partition(".")[0] for entry in folder.iterdir()} == {*ids, "lock"}
    assert api.http.delete(location).status_code == 204
    assert api.http.get(location).status_code == 404
    assert api.http.delete(location).status_code == 404
    assert {entry.name.partition(".")[0] for entry in folder.iterdir()} == {second["id"], "lock"}
    assert api.http.get(second["links"]["file"]).headers["content-type"] == (
        "application/octet-stream"
    )


def test_a_deleted_job_ends_what_is_computed_from_it(api: Api, run: RunRecord) -> None:
    """The child is killed, and who waits for it is told."""
    job = api.finished(run)
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(api.http.get, f"/v1/jobs/{job}/frames/0/surface")
        child = halted_child("reconstruct_surface")
        assert api.http.delete(f"/v1/jobs/{job}").status_code == 204
        assert answer.result(PATIENCE).status_code == 404, answer.result().text
    assert not child.is_running()


def test_the_contract_names_every_kind_of_file() -> None:
    """Of exports; the list is written down, because the formats are slow to import."""
    kinds = {format.media_type for format in FORMATS.values()}
    assert set(exports.MEDIA_TYPES) == kinds | {"application/zip"}


def test_the_looks_of_the_contract_are_those_of_the_engine() -> None:
    """Names of materials are written down in the schemas, which know no engine."""
    look = PictureOptions.model_json_schema()["properties"]["look"]["anyOf"][0]
    assert look["enum"] == list(MATERIALS)


def test_the_python_client_has_it_all(api: Api, run: RunRecord, tmp_path: Path) -> None:
    """Arrays, files and exports by one call each; what fails is an error with its remedy."""
    job = api.finished(run)
    with MorphClient(str(api.http.base_url)) as client:
        np.testing.assert_array_equal(client.source(job), run.source_points)
        np.testing.assert_array_equal(client.target(job), run.target_points)
        np.testing.assert_allclose(client.field(job, "displacement", 0), 1, rtol=1e-5)
        assert len(client.particles("sphere", points_per_cell_edge=2)) == run.particle_count
        assert "speed" in [field.name for field in client.fields()]
        assert "csv" in [format.name for format in client.export_formats()]
        assert loaded(client.surface(job, format="stl"), "stl").is_watertight
        assert client.thumbnail(job).startswith(b"RIFF")
        played = client.playback(job, seconds=1, fps=10, easing="linear", repeat="ping-pong")
        assert (played.fps, played.repeat, len(played.frames)) == (10, True, 10)
        assert (min(played.frames), max(played.frames)) == (0, pytest.approx(1, abs=0.3))
        with pytest.raises(ServiceError, match="first shape"):
            client.playback(job, repeat="loop")
        file = client.export(job, tmp_path / "cloud.npz", "npz", frames=[0])
        with np.load(file) as arrays:
            assert any(array.shape[-2:] == run.source_points.shape for array in arrays.values())
        still = PictureOptions(width=64, height=48, background="black")
        file = client.export(job, tmp_path / "a.gif", "gif", frames=[0], picture=still)
        with Image.open(file) as image:
            assert image.size == (64, 48) and image.convert("RGB").getpixel((0, 0)) == (0, 0, 0)
        with pytest.raises(ServiceError, match="plx"):
            client.export(job, tmp_path / "no", "plx")
        with pytest.raises(ServiceError, match="`surface`"):
            client.export(job, tmp_path / "no", "ply", snap=True)
