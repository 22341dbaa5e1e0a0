"""Jobs that version 0.1.0 queued are computed by today's worker."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from chamfer_morph.schemas import JobState

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")


def test_stored_jobs_are_computed(new_cluster: Callable[[str], Any], version_0_1_0: Path) -> None:
    """The queued one runs, and the cancelled one when it is resumed."""
    (version_0_1_0 / "data").rename(version_0_1_0.parent / "data0")  # where the cluster has its own
    cluster = new_cluster("")
    jobs = {record.name: record for record in cluster.queue.newest()}
    assert jobs["queued"].spec.config.method.destinations == "random"
    cluster.worker()
    cluster.wait_for_state(jobs["queued"].id, JobState.SUCCEEDED)
    cluster.queue.resume(jobs["cancelled"].id)
    cluster.wait_for_state(jobs["cancelled"].id, JobState.SUCCEEDED)
