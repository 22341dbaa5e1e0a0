"""The report's figures: what stands in them can be told apart and read."""

from itertools import pairwise

import numpy as np
import pytest

from chamfer_morph.reproduction.experiments.paper_tables import FAIRNESS, REGULARISERS
from chamfer_morph.reproduction.report import charts
from chamfer_morph.reproduction.report.particle_images import PointCloud, gallery
from chamfer_morph.reproduction.report.tables import tabulate
from chamfer_morph.reproduction.runs.store import Record


def records(experiment):
    """A made-up record of each run, with curves as long as it is."""
    values = np.random.default_rng(0).uniform(0.2, 0.3, len(experiment.runs))
    return {
        run.id: Record(
            run=run, digest="", status="complete", frames=run.frames,
            metrics={"two_sided": value},
            curves=dict.fromkeys(("two_sided", "overlap_01"), [float(value)] * run.frames),
        )
        for run, value in zip(experiment.runs, values, strict=True)
    }  # fmt: skip


def cloud(title, run):
    """A few particles."""
    points = np.random.default_rng(0).uniform(-5, 5, (50, 3))
    return PointCloud(title, run, points, np.full_like(points, 0.5))


def test_no_two_curves_of_a_panel_look_alike():
    """Runs of another length have panels of their own, in which colours and dashes are free."""
    figure = charts.curves(tabulate(FAIRNESS, records(FAIRNESS)), ("two_sided", "overlap_01"))
    assert len(figure.axes) == 4
    for axes in figure.axes:
        lines = axes.get_lines()
        assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == len(lines) > 1
        assert len({len(line.get_xdata()) for line in lines}) == 1


@pytest.mark.parametrize(("outlier", "scale"), [(0.3, "linear"), (2.0, "log")])
def test_an_outlier_does_not_squeeze_the_others(outlier, scale):
    """It makes the axis logarithmic."""
    found = records(REGULARISERS)
    last = REGULARISERS.runs[-1].id
    found[last] = found[last].model_copy(update={"metrics": {"two_sided": outlier}})
    (axes,) = charts.printed_against_ours(tabulate(REGULARISERS, found)).axes
    assert axes.get_xscale() == scale


def test_rows_of_a_gallery_have_labels_that_do_not_collide_and_titles_of_their_own():
    """A column whose last frame is another one says so where it is."""
    run = FAIRNESS.runs[0]
    rows = [
        (f"Physics, {edge} per edge", [cloud("target", run), cloud(f"frame {last}", run)])
        for edge, last in ((3, 39), (4, 39), (5, 31))
    ]
    figure = gallery(rows)
    figure.draw_without_rendering()
    assert [axes.get_title() for axes in figure.axes] == [
        "target", "frame 39", "", "", "", "frame 31",
    ]  # fmt: skip
    labels = [axes.yaxis.label.get_window_extent() for axes in figure.axes[::2]]
    assert all(above.y0 > below.y1 for above, below in pairwise(labels))
