"""On a full disk every request says so, and all is well once there is room."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tests.integration.api.conftest import COARSE, MORPH, Api


def test_a_full_disk_is_told(make_api: Callable[..., Api], small_disk: Path, cube: bytes) -> None:
    """507 for what would store something, 503 from /readyz; what reads goes on."""
    api = make_api(data_dir=small_disk / "data")
    job = api.submit(overrides=COARSE)["id"]
    assert api.http.get("/readyz").status_code == 200
    filling = small_disk / "filling"
    for step in (1 << 16, 1 << 9):
        with suppress(OSError), filling.open("ab", buffering=0) as file:
            while True:
                file.write(bytes(step))
    ready = api.http.get("/readyz")
    assert ready.status_code == 503 and "full" in ready.json()["detail"]
    assert ready.json()["remedy"] == "Free some space."
    mesh = {"params": {"name": "cube.obj"}, "content": cube + b"#" * 200_000}
    form = {"files": {"source": ("a.obj", mesh["content"])}, "data": {"job": '{"target": 1}'}}
    for answer in (
        api.http.post("/v1/meshes", **mesh),
        api.http.post("/v1/meshes", files={"file": ("cube.obj", mesh["content"])}),
        api.http.post("/v1/jobs", **form),
    ):
        assert answer.status_code == 507, answer.text
        assert answer.headers["Content-Type"] == "application/problem+json"
        assert "full" in answer.json()["detail"] and answer.json()["remedy"]
    submits = [api.http.post("/v1/jobs", json=MORPH | {"overrides": COARSE}) for _ in range(40)]
    assert {answer.status_code for answer in submits} <= {202, 507}  # its log has room left over
    assert submits[-1].status_code == 507, submits[-1].text
    assert api.http.get(f"/v1/jobs/{job}").status_code == 200
    filling.unlink()
    assert api.http.get("/readyz").status_code == 200
    assert api.http.post("/v1/meshes", **mesh).status_code == 201
    api.submit(overrides=COARSE)


def test_a_read_only_disk_is_told(
    make_api: Callable[..., Api], small_disk: Path, tmp_path: Path
) -> None:
    """To whoever looks after the service, for nothing heals by another try."""
    data = tmp_path / "data"
    data.mkdir()
    (data / "uploads").symlink_to(small_disk)
    api = make_api(data_dir=data)
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    ready = api.http.get("/readyz")
    assert ready.status_code == 503 and "Read-only" in ready.json()["detail"]
    assert "MORPH_DATA_DIR" in ready.json()["remedy"]
