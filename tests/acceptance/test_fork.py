"""A job that goes on from a frame of another, by real workers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from chamfer_morph.client import MorphClient
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.schemas import JobState
from morph_engine.results.trajectory import Trajectory
from tests.acceptance.conftest import POSTGRES_BY_FAULT_TESTS, Cluster
from tests.integration.api.conftest import Api, serving

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")

MORPH = Path(sys.executable).with_name("morph")
RUN = {"method": "joint", "frames": 4, "overrides": {"sampling.points_per_cell_edge": 1}}
SOFTER = {"material.youngs_modulus": 20000}


@pytest.fixture
def api(cluster: Cluster) -> Iterator[Api]:
    """The API of the cluster."""
    with serving(cluster.settings.model_copy(update={"port": 0})) as api:
        yield api


@pytest.fixture
def client(api: Api) -> Iterator[MorphClient]:
    """A client of it."""
    with MorphClient(str(api.http.base_url)) as client:
        yield client


def positions(cluster: Cluster, job: str) -> np.ndarray:
    """Positions of all frames of a job that succeeds, shape [frames, n, 3]."""
    record = cluster.wait_for_state(job, JobState.SUCCEEDED, JobState.FAILED)
    assert record.state is JobState.SUCCEEDED, record.problem
    cluster.storage.fetch(job)
    with Trajectory(cluster.storage.result_path(job)) as result:
        assert result.status == "complete"
        return np.stack(list(result))


@POSTGRES_BY_FAULT_TESTS
def test_a_job_is_forked(cluster: Cluster, client: MorphClient) -> None:
    """Frames up to the one named are the original's; it needs the original no more."""
    worker = cluster.worker()
    original = client.submit("sphere", "star", **RUN, states_every=2)
    expected = positions(cluster, original.id)
    with pytest.raises(ServiceError, match="no full state after frame 2, only after 1, 3"):
        client.fork(original.id, 2)
    with pytest.raises(ServiceError, match="cannot change grid"):
        client.fork(original.id, 1, overrides={"grid.dx": 2})
    with pytest.raises(ServiceError, match="none of the 4 frames is left"):
        client.fork(original.id)
    worker.terminate()
    worker.wait()
    through = client.submit("sphere", ["star", "torus"], **RUN)
    with pytest.raises(ServiceError, match="several shapes cannot be forked"):
        client.fork(through.id, 0)
    client.cancel(through.id)
    same = client.fork(original.id, 1, name="again", idempotency_key="one")
    assert client.fork(original.id, 1, name="again", idempotency_key="one").id == same.id
    with pytest.raises(ServiceError, match="Idempotency-Key"):
        client.fork(original.id, 3, idempotency_key="one", overrides={"frames": 6})
    softer = client.fork(original.id, 1, overrides=SOFTER)
    longer = client.fork(original.id, overrides={"frames": 6})
    assert same.state == "queued" and same.name == "again" and same.method == "joint"
    assert same.forked_from and same.forked_from.model_dump() == {
        "job": original.id, "frame": 1
    }  # fmt: skip
    client.delete(original.id)
    cluster.worker()
    np.testing.assert_array_equal(positions(cluster, same.id), expected)
    found = positions(cluster, softer.id)
    np.testing.assert_array_equal(found[:2], expected[:2])
    assert not np.array_equal(found[2], expected[2])
    found = positions(cluster, longer.id)
    assert len(found) == 6
    np.testing.assert_array_equal(found[:4], expected)
    assert [row["frame"] for row in client.metrics(same.id)] == [0, 1, 2, 3]
    assert client.config(softer.id)["method"]["material"]["youngs_modulus"] == 20000
    outcome = client.job(same.id).outcome
    assert outcome and outcome.frames == 4 and outcome.provenance["code"] == ""
    with pytest.raises(ServiceError, match="cannot start from the beginning"):
        client.retry(same.id)


@POSTGRES_BY_FAULT_TESTS
def test_a_job_that_was_cancelled_is_forked_at_its_last_frame(
    cluster: Cluster, api: Api, client: MorphClient
) -> None:
    """By the command; a fork that lost its frames says so, and one without states is refused."""
    worker = cluster.worker()
    original = client.submit("sphere", "star", **RUN | {"frames": 200})
    cluster.wait_for_frame(original.id, 1)
    client.cancel(original.id)
    worker.terminate()
    worker.wait()
    arguments = [MORPH, "fork", original.id, "--set", "material.youngs_modulus=20000"]
    made = subprocess.run(
        [*arguments, "--set", "frames=2000", "--server", str(api.http.base_url)],
        env=cluster.environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    job = client.job(made.stdout.strip())
    assert job.forked_from and job.progress.frames == 2000
    spool = Path(f"{cluster.storage.result_path(job.id)}.spool")
    (spool / "checkpoint.npz").write_bytes(b"damaged")
    cluster.worker()
    failed = cluster.wait_for_state(job.id, JobState.FAILED)
    assert failed.problem and "missing or damaged" in failed.problem.cause
    queued = client.submit("sphere", "star", **RUN, priority=1000)
    with pytest.raises(ServiceError, match="no full state from which"):
        client.fork(queued.id)
