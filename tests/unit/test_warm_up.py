"""What is made ready before there is a run is what the run needs."""

import pytest

from morph_engine.methods import DEFAULT_METHOD, names
from morph_engine.methods.flow import FlowOptions, grid_size
from morph_engine.morphing import prepare
from morph_engine.presets import configure
from morph_engine.warm_up import extent_of, small_run


@pytest.mark.parametrize("extent", [16, 24, 32, 48, 80])
def test_the_small_run_has_the_grid_that_is_guessed(extent: int) -> None:
    """Its kernels are those of runs with grids of that extent."""
    record = prepare("sphere", "sphere", small_run(extent=extent))
    assert extent_of(record) == extent


def test_grids_of_many_pairs_are_few() -> None:
    """Pairs of other counts and sizes have cells of other edges, and few extents."""
    config = configure()
    assert isinstance(config.method, FlowOptions)
    edges, extents = set(), set()
    for count in range(1000, 3000, 100):
        radius = 10.0 + count / 1000
        edge, extent = grid_size(config.method, config, radius=radius, ratio=count / 2000)
        edges.add(edge)
        extents.add(extent)
        assert extent * edge >= radius
    assert len(edges) == 20
    assert len(extents) <= 4
    assert all(extent % 4 == 0 for extent in extents)


def test_other_methods_have_no_guess() -> None:
    """Their grids follow from their settings."""
    for method in set(names()) - {DEFAULT_METHOD}:
        record = prepare("sphere", "sphere", small_run(method))
        assert record.config.method.name == method
        assert extent_of(record) is None
