"""The run lists: complete, consistent, and affordable."""

import re

import pytest

from chamfer_morph.reproduction.experiments.defaults import DEFAULTS
from chamfer_morph.reproduction.experiments.extensions import EXTENSIONS
from chamfer_morph.reproduction.experiments.paper_tables import NATIVE, PAPER_TABLES, SPHERE
from chamfer_morph.reproduction.meshes import ASSETS, MeshFolder
from chamfer_morph.reproduction.published.numbers import CLAIMS, PAPER, PROGRAM
from chamfer_morph.reproduction.registry import EXPERIMENTS, cpu_seconds_of, runs_of, select
from chamfer_morph.reproduction.report.findings import FINDINGS
from morph_engine import methods
from morph_engine.errors import ConfigError, MeshError

ALL_RUNS = [
    run
    for experiments in (PAPER_TABLES, EXTENSIONS, DEFAULTS)
    for experiment in experiments.values()
    for run in experiment.runs
]


def test_an_id_is_one_run_in_all_tables():
    """Tables share runs by id, so equal ids must be equal runs, and equal runs equal ids."""
    by_id, by_content = {}, {}
    for run in ALL_RUNS:
        assert by_id.setdefault(run.id, run) == run
        content = run.model_copy(update={"id": "-"}).model_dump_json()
        assert by_content.setdefault(content, run.id) == run.id


@pytest.mark.parametrize("table", PAPER)
def test_every_printed_cell_has_a_row_and_a_column(table):
    """No printed number is left without one of ours."""
    rows = {row.label: row for row in PAPER_TABLES[table].rows}
    for label, numbers in PAPER[table].items():
        assert rows[label].runs
        assert set(numbers) <= set(PAPER_TABLES[table].metrics)


def test_every_table_and_figure_of_the_paper_is_named_once():
    """Tables 1 to 11, of which 7 and 8 are of parameters, and figures 1 to 7."""
    named = {"able": [], "igure": []}
    for experiment in EXPERIMENTS.values():
        for kind, first, second in re.findall(
            r"(able|igure)s? (\d+)(?: and (\d+))?", experiment.origin
        ):
            named[kind] += [int(number) for number in (first, second) if number]
    assert sorted(named["able"]) == list(range(1, 12))
    assert sorted(named["igure"]) == [1, 2, 3, 4, 5, 6, 7]


def test_numbers_of_the_published_program_belong_to_runs():
    """None is left over."""
    assert PROGRAM.keys() <= {run.id for run in ALL_RUNS}


@pytest.mark.parametrize("quick", [False, True])
def test_every_run_has_a_valid_configuration(quick):
    """Methods, presets and settings exist, and quick runs are of their own."""
    for run in runs_of(select(["all", "trial", *EXTENSIONS, *DEFAULTS], quick=quick)):
        config = run.config()
        assert config.method.name == run.method in methods.names()
        assert config.sampling.fit == "none" and config.sampling.lattice == "published"
        assert {run.source, run.target} <= {*ASSETS, "sphere", "star"}


def test_printed_tables_are_the_papers():
    """Two-sided distances are the root of the sum of squares, to the rounding of both terms."""
    for table in ("sphere", "regularisers", "dragon", "ablation"):
        for label, numbers in PAPER[table].items():
            whole = (numbers["s2t"] ** 2 + numbers["t2s"] ** 2) ** 0.5
            assert numbers["two_sided"] == pytest.approx(whole, abs=0.0015), label


def test_claims_follow_from_the_printed_tables():
    """16 of 20 pairs, 20 of 20 in s→t, 2.5 times on the dragon."""
    pairs = {label.partition(", ")[0] for label in PAPER["pairs"]}
    assert len(pairs) == 20
    for metric in ("two_sided", "s2t"):
        wins = sum(
            PAPER["pairs"][f"{pair}, joint"][metric] < PAPER["pairs"][f"{pair}, physics"][metric]
            for pair in pairs
        )
        assert wins == CLAIMS[f"pairs_{metric}"]
    dragon = PAPER["dragon"]
    gain = (
        dragon["Physics, 3 per edge"]["two_sided"]
        / dragon["Joint, 4 per edge, native settings"]["two_sided"]
    )
    assert gain == pytest.approx(CLAIMS["dragon_gain"], abs=0.05)


def test_the_native_settings_are_those_of_the_published_file():
    """Algorithm 11.2, last line: everything that sets the fine dragon apart."""
    run = next(run for run in ALL_RUNS if run.id == "sphere-dragon-joint-native-n4")
    config = run.config()
    assert run.overrides == NATIVE and run.points_per_cell_edge == 4
    options = config.method
    assert (options.chamfer.huber_delta, options.chamfer.reverse_clamp) == (0, 0)
    assert (options.chamfer.reverse_weight, options.chamfer.reverse_coupled) == (1, False)
    assert (options.chamfer.reverse_smoothing, options.grid_loss.final_weight) == (0, 0.1)


def test_all_is_affordable():
    """Under four hours on two cores by the stated model, `sphere --quick` under ten minutes."""
    assert cpu_seconds_of(select(["all"])) / 2 < 4 * 3600
    assert cpu_seconds_of(select(["sphere"], quick=True)) / 2 < 600


def test_quick_runs_have_ids_of_their_own_and_say_so():
    """A quick number cannot be taken for a published one; points move the same in every preset."""
    quick = SPHERE.quick()
    assert "quick" in quick.title
    assert {run.preset for run in quick.runs} == {"fast"}
    assert not {run.id for run in quick.runs} & {run.id for run in SPHERE.runs}
    assert all(run == run.quick() for run in ALL_RUNS if run.method == "dco")


def test_an_unknown_table_names_a_near_one():
    """A typing error is told what was meant."""
    with pytest.raises(ConfigError, match="'sphere'"):
        select(["spehre"])
    assert [experiment.name for experiment in select(["sphere", "sphere"])] == ["sphere"]
    assert "trial" not in {experiment.name for experiment in select(["all"])}
    assert {"planar", *PAPER_TABLES} <= EXPERIMENTS.keys()


def test_every_experiment_has_findings():
    """None goes without a sentence on what its numbers show."""
    assert FINDINGS.keys() == PAPER_TABLES.keys() | EXTENSIONS.keys() | DEFAULTS.keys()


def test_missing_meshes_are_named_with_their_origins(tmp_path):
    """One error for all of them, with what to fetch where."""
    with pytest.raises(MeshError) as caught:
        MeshFolder(tmp_path).check(["bunny.obj", "cow.obj", "star"])
    assert "bunny.obj, cow.obj" in caught.value.cause
    assert "Stanford" in caught.value.remedy and "Crane" in caught.value.remedy


def test_a_mesh_of_another_scale_is_refused(tmp_path):
    """The originals are not in the paper's domain; a bunny of 15 cm would be a few particles."""
    lines = [f"v {x} {y} {z}" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    faces = ["1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2", "3 4 8", "3 8 7", "1 3 7",
             "1 7 5", "2 6 8", "2 8 4"]  # fmt: skip
    (tmp_path / "bunny.obj").write_text("\n".join([*lines, *(f"f {face}" for face in faces)]))
    with pytest.raises(MeshError, match="spans"):
        MeshFolder(tmp_path).check(["bunny.obj"])


def test_the_papers_meshes_pass(paper_mesh):
    """All of them lie where algorithm 1.5 has them."""
    MeshFolder(paper_mesh("sphere").parent).check(ASSETS)
