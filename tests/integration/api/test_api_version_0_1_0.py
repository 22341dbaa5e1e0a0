"""Jobs that version 0.1.0 stored are listed, shown and retried."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def test_stored_jobs_are_shown(make_api: Callable[..., Any], version_0_1_0: Path) -> None:
    """A finished, a cancelled and a queued one, with today's configuration and the old result."""
    api = make_api(data_dir=version_0_1_0 / "data")
    jobs = {job["name"]: job for job in api.http.get("/v1/jobs").json()["items"]}
    states = {name: (job["state"], job["method"]) for name, job in jobs.items()}
    assert states == {
        "finished": ("succeeded", "joint"),
        "cancelled": ("cancelled", "dco"),
        "queued": ("queued", "transport"),
    }
    configs = {
        name: api.http.get(f"/v1/jobs/{job['id']}/config").json() for name, job in jobs.items()
    }
    assert configs["finished"]["method"]["chamfer"]["normalize"] is False
    assert configs["finished"]["method"]["optimizer"]["passes"] == 1
    assert "descent" not in configs["finished"]["method"]
    assert configs["cancelled"]["method"]["regularizers"]["volume"] == 0.1
    assert configs["queued"]["method"]["destinations"] == "random"
    path = f"/v1/jobs/{jobs['finished']['id']}"
    frame = api.http.get(f"{path}/frames/0?format=f32")
    assert len(frame.content) == 12 * jobs["finished"]["outcome"]["particle_count"]
    assert api.http.get(f"{path}/thumbnail").status_code == 200
    assert api.http.get(f"{path}/metrics").json()[0]["two_sided"] == pytest.approx(
        jobs["finished"]["outcome"]["metrics"]["two_sided"]
    )
