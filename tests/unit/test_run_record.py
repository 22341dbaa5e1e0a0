"""What a record says of a run's frames."""

import numpy as np
import pytest

from morph_engine.morphing import prepare
from morph_engine.presets import configure

SMALL = {"sampling.points_per_cell_edge": 2}


def lattice(count: int, spacing: float) -> np.ndarray:
    """A cube of points."""
    axis = spacing * np.arange(count)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def test_the_spacing_of_a_frame_grows_with_the_body_and_no_further_than_the_target() -> None:
    """Half as many particles as target points end up 2^(1/3) as far apart, or clumped: h."""
    small, large = lattice(10, 0.5), lattice(10, 0.5)
    large = np.concatenate([large, large + 0.25])
    record = prepare(small, large, configure(overrides=SMALL))
    h = record.config.spacing
    assert record.spacing_of(small) == h
    assert record.spacing_of(0.7 * small) == h
    assert record.spacing_of(1.1 * small) == pytest.approx(1.1 * h, rel=1e-5)
    assert record.spacing_of(3 * small) == pytest.approx(2 ** (1 / 3) * h)
    back = prepare(large, small, configure(overrides=SMALL))
    assert back.spacing_of(1.1 * large) == h
