"""Frames of a job whose engine was killed: they are in its result all the same."""

from __future__ import annotations

import io

import h5py
import numpy as np

from morph_engine.results.spool import Spool


def frames_of(api, job):
    """Frames of the result as it is served."""
    answer = api.http.get(f"/v1/jobs/{job}/result")
    assert answer.status_code == 200, answer.text
    with h5py.File(io.BytesIO(answer.content)) as file:
        return file["VTKHDF"]["Steps"].attrs["NSteps"]


def add_frame(api, job, run, index, moved):
    """Finish one frame more, and leave no result."""
    with Spool.open(api.context.storage.result_path(job)) as spool:
        spool.append(index, run.source_points + np.float32([moved, 0, 0]), {"s2t": moved})


def test_frames_without_a_result_are_made_one(api, run):
    """The engine was killed before it could write it."""
    job = api.running(run)
    api.http.post(f"/v1/jobs/{job}/cancel")
    assert not api.context.storage.result_path(job).exists()
    assert frames_of(api, job) == 2


def test_frames_beyond_an_older_result_are_added(api, run):
    """The job was cancelled, resumed, and its engine killed later on."""
    job = api.finished(run)
    before = api.http.get(f"/v1/jobs/{job}/result").headers["ETag"]
    add_frame(api, job, run, 2, 5)
    last = api.http.get(f"/v1/jobs/{job}/frames/-1")
    assert last.headers["Morph-Frame"] == "2"
    moved = np.frombuffer(last.content, "<f4").reshape(-1, 3) - run.source_points
    np.testing.assert_allclose(moved, np.broadcast_to([5, 0, 0], moved.shape), atol=1e-5)
    assert frames_of(api, job) == 3
    assert api.http.get(f"/v1/jobs/{job}/result").headers["ETag"] != before


def test_a_job_without_frames_says_what_to_do(api):
    """It rests, so there is nothing to wait for."""
    job = api.submit()["id"]
    api.http.post(f"/v1/jobs/{job}/cancel")
    answer = api.http.get(f"/v1/jobs/{job}/result")
    assert answer.status_code == 409
    assert "Resume or retry" in answer.json()["remedy"]
