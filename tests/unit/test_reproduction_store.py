"""What is kept of a run, and when it is computed again."""

import json
import math
from pathlib import Path

import pytest

from chamfer_morph.reproduction.meshes import MeshFolder
from chamfer_morph.reproduction.registry import EXPERIMENTS
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.runner import known_records
from chamfer_morph.reproduction.runs.store import Record, Store
from morph_engine.results.provenance import Provenance

RUN = Run(id="a", source="sphere", target="star", method="joint", points_per_cell_edge=1)


@pytest.fixture
def meshes(tmp_path):
    """A folder without meshes: built-in shapes need none."""
    return MeshFolder(tmp_path / "none")


@pytest.fixture
def store(tmp_path):
    """An empty store."""
    return Store(tmp_path / "results")


def complete(run, digest, *, code="", **metrics):
    """A record of a finished run, computed by some code."""
    return Record(
        run=run, digest=digest, status="complete", metrics=metrics, frames=run.frames,
        provenance=Provenance(code=code, cpu_seconds=7.0),
    )  # fmt: skip


def test_a_record_comes_back_as_it_was(store, meshes):
    """Every digit, infinities included."""
    digest = RUN.digest(meshes)
    record = complete(RUN, digest, two_sided=0.1 + 0.2, hausdorff=math.inf)
    store.save(record)
    assert store.find(RUN, digest) == record
    assert json.loads(store.record_path(RUN).read_text())["digest"] == digest


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 43},
        {"frames": 41},
        {"method": "physics"},
        {"points_per_cell_edge": 2},
        {"preset": "fast"},
        {"overrides": {"chamfer.reverse_clamp": 5.0}},
        {"target": "torus"},
    ],
)
def test_whatever_changes_the_result_changes_the_digest(store, meshes, change):
    """The record of another configuration or shape is not this run's."""
    store.save(complete(RUN, RUN.digest(meshes)))
    changed = RUN.model_copy(update=change)
    assert store.find(changed, changed.digest(meshes)) is None


def test_a_changed_mesh_changes_the_digest(tmp_path):
    """The file counts by its content."""
    run = RUN.model_copy(update={"target": "letter_V.obj"})
    digests = []
    for number, text in enumerate(("v 0 0 0\n", "v 0 0 1\n")):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "letter_V.obj").write_text(text)
        digests.append(run.digest(MeshFolder(folder)))
    assert digests[0] != digests[1]


def test_the_id_is_a_name_and_no_input(meshes):
    """A renamed run has the same digest."""
    assert RUN.model_copy(update={"id": "b"}).digest(meshes) == RUN.digest(meshes)


@pytest.mark.parametrize("torn", ["", "{", '{"run": {}}', None])
def test_a_torn_record_counts_as_absent(store, meshes, torn):
    """Half a file is computed again, not believed."""
    digest = RUN.digest(meshes)
    store.save(complete(RUN, digest))
    path = store.record_path(RUN)
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2] if torn is None else torn)
    assert store.read(RUN, digest) is None


def test_a_failure_is_kept_and_tried_again(store, meshes):
    """The cause can be read, and the next command computes the run."""
    digest = RUN.digest(meshes)
    store.save_progress(RUN, digest, Provenance(code="a", cpu_seconds=3.0))
    store.save_failure(RUN, digest, "It burst.")
    record = store.read(RUN, digest)
    assert record is not None and record.problem == "It burst."
    assert record.provenance.cpu_seconds == 3.0
    assert store.find(RUN, digest) is None
    assert known_records([RUN], store, meshes, any_code=True) == {}


def test_a_run_under_way_is_not_there_but_its_cost_is_known(store, meshes):
    """Until it is complete, when there is nothing to go on with."""
    digest = RUN.digest(meshes)
    assert store.progress(RUN, digest) == Provenance()
    under_way = Provenance(code="a", cpu_seconds=3.0)
    store.save_progress(RUN, digest, under_way)
    assert store.find(RUN, digest) is None
    assert known_records([RUN], store, meshes, any_code=True) == {}
    assert store.progress(RUN, digest) == under_way
    assert store.progress(RUN, "another digest") == Provenance()
    store.save(complete(RUN, digest, code="a"))
    assert store.progress(RUN, digest) == Provenance()


def test_a_run_of_other_code_counts_only_if_any_will_do(store, meshes):
    """The code's digest decides, and a record that names none is of other code, too."""
    digest = RUN.digest(meshes)
    for code, counts in ((RUN.code, True), ("0" * 64, False), ("", False)):
        record = complete(RUN, digest, code=code)
        store.save(record)
        assert known_records([RUN], store, meshes) == ({RUN.id: record} if counts else {})
        assert known_records([RUN], store, meshes, any_code=True) == {RUN.id: record}


def test_records_of_version_0_1_0_are_found(paper_mesh, tmp_path):
    """Those that are committed, unless a mesh or a setting differs; they do not name their code."""
    meshes = MeshFolder(paper_mesh("sphere").parent)
    committed = Store(Path(__file__).parents[2] / "docs" / "results")
    runs = (*EXPERIMENTS["sphere"].runs, *EXPERIMENTS["regularisers"].runs)
    assert known_records(runs, committed, meshes) == {}
    known = known_records(runs, committed, meshes, any_code=True)
    assert known.keys() == {run.id for run in runs}
    assert all(known[run.id].digest == run.digest(meshes) for run in runs)
    for record in known.values():
        document = json.loads(committed.record_path(record.run).read_bytes())
        assert record.provenance == Provenance(cpu_seconds=document["cpu_seconds"])
    run = runs[0].model_copy(update={"frames": 41})
    assert known_records([run], committed, meshes, any_code=True) == {}
    for name in runs[0].shapes:
        (tmp_path / name).write_text("v 0 0 0\n")
    assert known_records([runs[0]], committed, MeshFolder(tmp_path), any_code=True) == {}
