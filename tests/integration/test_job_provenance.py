"""What a job of the service tells of the code that computed it."""

from __future__ import annotations

from pathlib import Path

import pytest

from chamfer_morph.schemas import BuiltInShape
from chamfer_morph.worker.engine_process import _compute
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.storage import Storage
from morph_engine.code_digest import code_digest
from morph_engine.presets import configure
from morph_engine.results.provenance import Provenance
from morph_engine.results.spool import spool_path

CODE = code_digest("dco")


@pytest.mark.parametrize(
    ("earlier", "named"),
    [([CODE], CODE), (["0" * 64, CODE], ""), ([None], "")],
    ids=["same", "other", "unknown"],
)
def test_a_job_names_its_code_if_all_its_frames_are_of_it(
    version_0_1_0: Path, tmp_path: Path, earlier: list[str | None], named: str
) -> None:
    """Here two frames of three were computed by earlier attempts."""
    storage = Storage(tmp_path / "data")
    storage.job_dir("job").mkdir()
    unfinished = spool_path(version_0_1_0 / "dco-unfinished.vtkhdf")
    unfinished.rename(spool_path(storage.result_path("job")))
    for attempt, code in enumerate(earlier, 1):
        storage.events("job").append(
            "attempt", {"attempt": attempt} | ({"code": code} if code else {})
        )
    sphere = BuiltInShape(shape="sphere")
    spec = JobSpec(
        source=sphere, target=sphere, config=configure(), device="cpu", timeout_seconds=60
    )
    outcome = _compute(storage, "job", spec, attempt=len(earlier) + 1, threads=1)
    provenance = Provenance.model_validate(outcome.provenance)
    assert outcome.frames == 3 and provenance.code == named
    assert (provenance.device, provenance.threads) == ("cpu", 1)
    assert provenance.cpu and provenance.date and provenance.wall_seconds > 0
    assert storage.events("job").read()[len(earlier)].data["code"] == CODE
