"""The paper's statements hold where they say so, and their limits are real."""

from __future__ import annotations

import numpy as np
import pytest

from chamfer_morph.reproduction.propositions import Quantity, all_checks, figure
from chamfer_morph.reproduction.propositions.coupling import (
    CELLS,
    NARROW,
    SHIFTS,
    WIDE,
    basis,
    coupled_drift,
    grid,
    independent,
)
from chamfer_morph.reproduction.propositions.penalties import PENALTIES, neighbor_lists
from chamfer_morph.reproduction.propositions.scene import TARGETS, cluster, elsewhere

NAMES = ["Proposition 1", "Proposition 2", "Proposition 3", "Corollary 1"]


@pytest.fixture(scope="module")
def checks():
    """All of them, computed once."""
    return all_checks()


def test_the_four_statements_in_order(checks):
    """Propositions 1 to 3 and corollary 1."""
    assert [check.name for check in checks] == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_identities_hold(checks, name):
    """Every quantity is what the statement says."""
    (check,) = (check for check in checks if check.name == name)
    assert check.quantities
    assert [each for each in check.quantities if not each.holds] == []


def test_the_corollary_is_refuted_and_the_propositions_are_not(checks):
    """Every counterexample within the assumptions is a real one, and only the corollary has any."""
    *propositions, corollary = checks
    assert all(check.holds and not check.refuted_by for check in propositions)
    assert len(corollary.refuted_by) == 2
    assert all(each.is_counterexample for each in corollary.refuted_by)
    assert corollary.is_refuted and not corollary.holds


def test_what_a_grid_does_depends_on_its_cells():
    """Cells with points of the cluster alone leave its drift; wide ones change it, anywhere."""
    for shift in SHIFTS:
        drifts = [coupled_drift(grid(cell, shift)) for cell in CELLS]
        assert all(
            drift == pytest.approx(1, abs=1e-12)
            for cell, drift in zip(CELLS, drifts, strict=True)
            if cell <= NARROW
        )
        assert max(drifts[CELLS.index(WIDE) :]) < 0.75


@pytest.mark.parametrize("name", NAMES)
def test_limits_are_counterexamples(checks, name):
    """Every limit breaks the statement's prediction."""
    (check,) = (check for check in checks if check.name == name)
    assert check.limits
    assert [each for each in check.limits if not each.is_counterexample] == []


@pytest.mark.parametrize("name", PENALTIES)
def test_penalty_gradients(name):
    """Gradients are those of the penalties, and sum to zero."""
    points = cluster()
    lists = neighbor_lists(points, 3)
    penalty = PENALTIES[name]
    gradient = penalty(points, lists)[1]
    step = 1e-6
    for index in range(points.size):
        shift = np.zeros_like(points)
        shift.flat[index] = step
        change = penalty(points + shift, lists)[0] - penalty(points - shift, lists)[0]
        # truncation of the steepest penalty, 1/d^2 at d = .1: step^2 times 120/d^5
        assert gradient.flat[index] == pytest.approx(change / (2 * step), rel=1e-5, abs=1e-5)
    scale = abs(gradient).max()
    np.testing.assert_allclose(gradient.sum(axis=0) / scale, 0, atol=1e-13)


@pytest.mark.parametrize("coupling", [independent, basis, *map(grid, CELLS)])
def test_couplings_leave_translations_alone(coupling):
    """A common direction passes unchanged, so that rates can be compared."""
    points = np.vstack([cluster(), elsewhere()])
    common = np.tile([0.3, -0.2], (len(points), 1))
    np.testing.assert_allclose(coupling(points, common), common, atol=1e-14)


def test_independent_points_have_ratio_one():
    """Without coupling the drift is the proposition's, with points elsewhere present."""
    assert coupled_drift(independent) == pytest.approx(1, abs=1e-12)


def test_scene_is_as_described():
    """The cluster lies in the cell of q*, all other points outside."""
    for points, inside in ((cluster(), True), (elsewhere(), False)):
        distance = np.linalg.norm(points[:, None] - TARGETS, axis=-1)
        assert ((distance.argmin(axis=1) == 0) == inside).all()


@pytest.mark.parametrize(
    ("relation", "measured", "holds"),
    [
        ("=", 1.05, True),
        ("=", 1.2, False),
        ("<=", 0.0, True),
        ("<=", 1.2, False),
        (">=", 2.0, True),
        (">=", 0.8, False),
        (">=", 0.95, True),
    ],
)
def test_relations(relation, measured, holds):
    """A quantity holds within its tolerance on the side that matters."""
    assert Quantity("x", measured, 1.0, relation, 0.1).holds is holds


def test_not_a_number_holds_nowhere():
    """A failed measurement is no success."""
    assert not any(Quantity("x", float("nan"), 1.0, each).holds for each in ("=", "<=", ">="))


def test_figure_has_a_column_per_statement():
    """Four scenes, each with its measurement below."""
    picture = figure()
    assert len(picture.axes) == 8
    titles = [axes.get_title().splitlines()[0] for axes in picture.axes[:4]]
    assert titles == NAMES
