"""A job that equals one which has succeeded need not be computed."""

from __future__ import annotations

import sys
from contextlib import ExitStack

import pytest

from chamfer_morph.client import MorphClient
from chamfer_morph.schemas import JobState
from tests.acceptance.conftest import POSTGRES_BY_FAULT_TESTS
from tests.integration.api.conftest import serving

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")

RUN = {"method": "joint", "frames": 1, "overrides": {"sampling.points_per_cell_edge": 1}}


@POSTGRES_BY_FAULT_TESTS
def test_equal_jobs(cluster):
    """The bytes are the same, and none of them is computed; anything else is another run."""
    worker = cluster.worker()
    settings = cluster.settings.model_copy(update={"port": 0})
    with ExitStack() as stack:
        api = stack.enter_context(serving(settings))
        client = stack.enter_context(MorphClient(str(api.http.base_url)))
        first = client.submit("sphere", "star", **RUN)
        cluster.wait_for_state(first.id, JobState.SUCCEEDED)
        worker.terminate()
        worker.wait()
        equal = client.submit("sphere", "star", **RUN, reuse=True, name="again", timeout_seconds=9)
        assert equal.state == "succeeded" and equal.name == "again"
        assert equal.reused_from == first.id and client.job(first.id).reused_from is None
        assert equal.outcome == client.job(first.id).outcome and equal.outcome.provenance["code"]
        assert client.metrics(equal.id) == client.metrics(first.id) != []
        paths = [cluster.storage.result_path(job) for job in (first.id, equal.id)]
        one, other = (path.read_bytes() for path in paths)
        assert one == other
        for job in (
            client.submit("sphere", "star", **RUN),
            client.submit("sphere", "star", **RUN | {"frames": 2}, reuse=True),
            client.submit("sphere", "star", **RUN, seed=1, reuse=True),
            client.submit("star", "sphere", **RUN, reuse=True),
            client.submit("sphere", "star", **RUN, reuse=True, states_every=1),  # it kept none
        ):
            assert job.state == "queued"
        client.delete(first.id)
        again = client.submit("sphere", "star", **RUN, reuse=True)
        assert again.state == "succeeded" and paths[1].read_bytes() == other
        assert again.reused_from == first.id
        paths[1].unlink()
        cluster.storage.result_path(again.id).unlink()
        assert client.submit("sphere", "star", **RUN, reuse=True).state == "queued"
        client.retry(again.id)
        cluster.worker()
        cluster.wait_for_state(again.id, JobState.SUCCEEDED)
        assert client.job(again.id).reused_from is None
