"""The headline's measure of a run's end, and that it owes nothing to what methods are given."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from chamfer_morph.reproduction.experiments.extensions import HEADLINE
from chamfer_morph.reproduction.report.findings import findings
from chamfer_morph.reproduction.report.tables import tabulate
from chamfer_morph.reproduction.runs import ends
from chamfer_morph.reproduction.runs.ends import measure_end
from chamfer_morph.reproduction.runs.store import Record
from morph_engine.geometry.sampling import sample_lattice
from morph_engine.geometry.shapes import make
from morph_engine.metrics.independent import Reference
from morph_engine.optimal_transport import even_destinations, random_destinations

SPACING = 1 / 3
COINCIDING = 1e-3
"""Points closer than this [dx] coincide: of 100 000 random ones in a star, one in 10^6 does."""


@pytest.fixture(scope="module")
def lattice() -> np.ndarray:
    """What every method is given of the star."""
    return sample_lattice(make("star"), spacing=SPACING).astype(np.float64)


@pytest.fixture(scope="module")
def destinations(lattice) -> dict[str, np.ndarray]:
    """Every set of places that a method sends particles to or measures itself by."""
    few, many = round(0.7 * len(lattice)), round(1.3 * len(lattice))
    return {
        "the target's lattice": lattice,
        "even, fewer": even_destinations(lattice, few, SPACING),
        "even, as many": even_destinations(lattice, len(lattice), SPACING),
        "even, more": even_destinations(lattice, many, SPACING),
        "random, more": random_destinations(lattice, many),
    }


def coinciding(points, others):
    """Share of points that lie on one of the others."""
    return np.mean(cKDTree(others).query(points)[0] < COINCIDING)


@pytest.mark.parametrize("seed", ends.SEEDS)
def test_no_method_is_sent_to_a_point_of_the_reference(destinations, lattice, seed):
    """A method that is would end on the points by which it is judged."""
    reference = Reference(make("star"), count=ends.POINTS, seed=seed)
    for name, places in destinations.items():
        assert coinciding(places, reference.points) < 1e-4, name
        assert coinciding(places, reference.lattice) < 1e-4, name
    assert coinciding(destinations["even, as many"], lattice) == 1  # so it would be seen


@pytest.fixture(scope="module")
def measured(lattice):
    """How well the target's own lattice fills it, by both draws."""
    return measure_end(lattice, "star")


def test_destinations_have_no_advantage(measured):
    """The target's own lattice ends where any other lattice ends: at the floors, not at zero."""
    (m, _) = measured
    assert 0.97 < m["dense_t2s"] / m["dense_floor"] < 1.1
    assert m["dense_s2t"] == pytest.approx(m["dense_s2t_floor"], rel=0.1)


def test_the_draws_differ_and_agree(measured):
    """Two seeds, other points, the same numbers."""
    first, second = measured
    assert first != second
    assert second == pytest.approx(first, rel=0.02)


def test_what_was_measured_before_changes_nothing(lattice):
    """Runs share the points of their target: each is measured as if it were the only one."""
    reference = Reference(make("star"), count=5_000)
    spacing = reference.spacing(len(lattice))
    first = reference.measure(lattice, spacing)
    assert reference.measure(lattice + np.float32([3, 0, 0]), spacing) != first
    assert reference.measure(lattice, spacing) == first


def test_draws_that_disagree_are_made_larger(lattice, monkeypatch):
    """Particles in heaps have few places: chance is large there, and more points are drawn."""
    monkeypatch.setattr(ends, "POINTS", 20_000)
    ends._references.cache_clear()
    heaps = lattice[:: len(lattice) // 8].repeat(100, axis=0)
    for points, sets in ((lattice, ends.SETS), (heaps, ends.MORE_SETS)):
        reference = Reference(make("star"), count=ends.POINTS, seed=ends.SEEDS[0], sets=sets)
        assert measure_end(points, "star")[0]["dense_s2t"] == reference.distance_to_mesh(points)
    ends._references.cache_clear()


def test_the_headline_tells_how_far_a_second_draw_moves_a_number():
    """The largest of all moves, relative to the larger of both values, and where it is."""
    first = dict.fromkeys(HEADLINE.metrics, 0.5)
    draws = {"sphere-duck-transport": {"mesh_iou_level": 0.49}, "cow-duck-transport": {}}
    records = {
        run.id: Record(
            run=run, digest="", status="complete", metrics={"surface_mean": 9.0},
            ends=[first, first | draws[run.id]],
        )
        for run in HEADLINE.runs
        if run.id in draws
    }  # fmt: skip
    table = tabulate(HEADLINE, records)
    assert table.ours("Sphere → Duck, transport", "surface_mean") == 0.5  # not the run's own 9
    assert "moves by more than 2.0% (IoU with the mesh of Sphere → Duck, transport)" in (
        " ".join(findings(table))
    )


def test_a_row_names_each_method_on_each_pair():
    """25 pairs, six methods; floors do not compete."""
    table = tabulate(HEADLINE, {})
    assert len(table.groups) == 25
    methods = ("flow", "transport", "joint", "physics", "DCO", "DCD")
    assert {line.row.label for line in table.lines} == {
        f"{pair}, {method}" for pair in table.groups for method in methods
    }
