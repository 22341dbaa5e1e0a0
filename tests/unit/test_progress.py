"""How far a job has come, by its events."""

from __future__ import annotations

from pathlib import Path

from chamfer_morph.schemas import BuiltInShape
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.progress import read_progress
from chamfer_morph.worker.storage import Storage
from morph_engine.presets import configure

FRAME = {"frame": 0, "attempt": 1, "metrics": {"s2t": 1.0}, "seconds": 2.0}


def test_the_stage_is_told_until_there_is_a_frame(tmp_path: Path) -> None:
    """Each attempt has its own; what a later version may call a stage is passed over."""
    storage = Storage(tmp_path)
    storage.job_dir("job").mkdir()
    config = configure("fast", {"frames": 3})
    sphere = BuiltInShape(shape="sphere")
    spec = JobSpec(source=sphere, target=sphere, config=config, timeout_seconds=60)
    log, stages = storage.events("job"), []
    for kind, data in (
        ("attempt", {"attempt": 1}),
        ("stage", {"stage": "filling"}),
        ("stage", {"stage": "computing"}),
        ("frame", FRAME),
        ("attempt", {"attempt": 2}),
        ("stage", {"stage": "preparing"}),
        ("stage", {"stage": "something new"}),
    ):
        log.append(kind, data)
        stages.append(read_progress(storage, "job", spec).stage)
    assert stages == [None, "filling", "computing", None, None, "preparing", None]
