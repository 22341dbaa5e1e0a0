"""A run of the reproduction after an interruption, by the same code and by other code."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from chamfer_morph.reproduction.meshes import MeshFolder
from chamfer_morph.reproduction.runs import ends
from chamfer_morph.reproduction.runs.ends import with_ends
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.run_process import compute
from chamfer_morph.reproduction.runs.store import Store
from morph_engine import morphing
from morph_engine.results.provenance import Provenance
from morph_engine.results.spool import spool_path

RUN = Run(
    id="a", source="sphere", target="star", method="dco", preset="fast", frames=4,
    points_per_cell_edge=1,
)  # fmt: skip

LONG_AGO = 1000.0
"""CPU and wall time of the part that was interrupted [s]: more than a part of a test takes."""


@pytest.fixture
def meshes(tmp_path: Path) -> MeshFolder:
    """A folder without meshes: built-in shapes need none."""
    return MeshFolder(tmp_path / "none")


@pytest.fixture
def interrupted(tmp_path: Path, meshes: MeshFolder) -> Callable[[str], Store]:
    """Makes a store with a run that some code began and that was killed after two frames."""

    def make(code: str) -> Store:
        store = Store(tmp_path / "results")
        out = store.result_path(RUN)
        out.parent.mkdir(parents=True)
        wanted = morphing.prepare(RUN.source, RUN.target, RUN.config())
        frames = morphing.run(wanted, device="cpu", threads=1, out=out)
        next(frames), next(frames)
        shutil.copytree(spool_path(out), tmp_path / "kept")
        frames.close()
        out.unlink()
        shutil.rmtree(spool_path(out))
        (tmp_path / "kept").rename(spool_path(out))
        so_far = Provenance(code=code, wall_seconds=LONG_AGO, cpu_seconds=LONG_AGO)
        store.save_progress(RUN, RUN.digest(meshes), so_far)
        return store

    return make


def marked(store: Store) -> np.ndarray:
    """Move the particles of the first stored frame, by which it is known again; the frame."""
    path = spool_path(store.result_path(RUN)) / "frame-000000.npz"
    with np.load(path) as stored:
        arrays = dict(stored)
    arrays["positions"] += np.float32(0.5)
    np.savez(path, **arrays)
    return arrays["positions"]


def test_it_goes_on_by_the_same_code_and_has_the_times_of_both_parts(interrupted, meshes) -> None:
    """Frames that are there are not computed again."""
    store = interrupted(RUN.code)
    first_frame = marked(store)
    record = compute(RUN, store, meshes, threads=1)
    with store.trajectory(RUN) as result:
        np.testing.assert_array_equal(result.positions(0), first_frame)
    assert record.is_complete and record.frames == 4
    provenance = record.provenance
    assert provenance.wall_seconds > LONG_AGO and provenance.cpu_seconds > LONG_AGO
    assert (provenance.code, provenance.device, provenance.threads) == (RUN.code, "cpu", 1)
    assert provenance.date is not None and provenance.cpu
    assert store.find(RUN, RUN.digest(meshes)) == record


def test_it_begins_anew_by_other_code(interrupted, meshes) -> None:
    """No frame of the old code is left in the result, nor its cost."""
    store = interrupted("0" * 64)
    first_frame = marked(store)
    record = compute(RUN, store, meshes, threads=1)
    with store.trajectory(RUN) as result:
        assert not np.array_equal(result.positions(0), first_frame)
    assert record.provenance.code == RUN.code
    assert 0 < record.provenance.cpu_seconds < LONG_AGO


@pytest.mark.parametrize("code", [RUN.code, "0" * 64, None], ids=["same", "other", "unknown"])
def test_a_result_without_its_record_counts_if_the_same_code_made_it(
    tmp_path, meshes, code
) -> None:
    """As after a kill between the two: it is measured again, or computed again."""
    store = Store(tmp_path / "results")
    digest = RUN.digest(meshes)
    compute(RUN, store, meshes, threads=1)
    written = store.result_path(RUN).stat().st_mtime_ns
    store.record_path(RUN).unlink()
    if code is not None:
        store.save_progress(RUN, digest, Provenance(code=code, cpu_seconds=LONG_AGO))
    record = compute(RUN, store, meshes, threads=1)
    assert record.provenance.code == RUN.code
    is_kept = store.result_path(RUN).stat().st_mtime_ns == written
    assert is_kept == (code == RUN.code) == (record.provenance.cpu_seconds == LONG_AGO)


@pytest.fixture
def few_points(monkeypatch) -> Iterator[None]:
    """The end of a run is measured by few points."""
    for name in ("POINTS", "SURFACE_POINTS"):
        monkeypatch.setattr(ends, name, 10_000)
    ends._references.cache_clear()
    yield
    ends._references.cache_clear()


@pytest.mark.usefixtures("few_points")
def test_a_record_keeps_its_end_against_the_mesh(tmp_path, meshes) -> None:
    """It is measured once, from the result file, and told when that is gone."""
    store = Store(tmp_path / "results")
    record = compute(RUN, store, meshes, threads=1)
    assert not record.ends
    measured = with_ends([RUN], {RUN.id: record}, store, meshes)[RUN.id]
    first, second = measured.ends
    assert first.keys() == second.keys() and first != second
    assert {"dense_t2s", "dense_s2t", "mesh_iou_level", "surface_mean"} <= first.keys()
    store.result_path(RUN).unlink()
    kept = store.find(RUN, RUN.digest(meshes))
    assert kept == measured == with_ends([RUN], {RUN.id: kept}, store, meshes)[RUN.id]
