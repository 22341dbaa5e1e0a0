"""The published direct Chamfer optimisation of sphere -> bunny, n3 = 3 (algorithm 8.2)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from morph_engine.methods import Problem
from morph_engine.methods.dco import Dco
from morph_engine.metrics.chamfer import chamfer_metrics
from morph_engine.morphing import prepare
from morph_engine.presets import configure


def test_dco_reproduces_the_published_rows(
    paper_mesh: Callable[[str], Path], float32_device: None
) -> None:
    """Distances of the start, after 1200 steps, and their collapse, as the reference has them.

    The reference drew its jitter in another order. Three jitters end at .2197 to .2219, with t2s
    of .2088 to .2112, a worst point at 1.41 to 1.56 and 11.9 % to 12.3 % in overlap.
    """
    config = configure("published", {"method": "dco"})
    record = prepare(paper_mesh("sphere"), paper_mesh("bunny"), config)
    method = Dco(Problem(record.source_points, record.target_points, config))
    start = chamfer_metrics(record.source_points, record.target_points, spacing=1 / 3)
    assert start["s2t"] == pytest.approx(0.773, abs=3e-3)
    assert start["t2s"] == pytest.approx(0.898, abs=3e-3)
    assert start["hausdorff"] == pytest.approx(6.88, abs=0.05)
    for frame in range(40):
        outcome = method.advance(frame)
    end = chamfer_metrics(
        outcome.positions,
        record.target_points,
        spacing=1 / 3,
        d_fwd=outcome.d_fwd,
        nearest_fwd=outcome.nearest_fwd,
        d_rev=outcome.d_rev,
    )
    assert end["s2t"] == pytest.approx(0.068, abs=2e-3)
    assert end["t2s"] == pytest.approx(0.209, abs=3e-3)
    assert end["two_sided"] == pytest.approx(0.220, abs=3e-3)
    assert end["f1"] == pytest.approx(0.836, abs=3e-3)
    assert end["hausdorff"] == pytest.approx(1.456, abs=0.15)
    assert end["overlap_01"] == pytest.approx(0.122, abs=0.01)
