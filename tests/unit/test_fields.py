"""Fields: what each number is, by hand on few particles."""

import numpy as np
import pytest

from morph_engine.errors import ConfigError, ResultError
from morph_engine.results.fields import FIELDS, field

SOURCE = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]], np.float32)
PREVIOUS = SOURCE + np.float32([0, 1, 0])
POSITIONS = SOURCE + np.float32([0, 3, 4])
TARGET = np.array([[0, 3, 4], [2.25, 3, 4]], np.float32)


def values(name, **changes):
    """A field of the particles above."""
    known = {"positions": POSITIONS, "previous": PREVIOUS, "source": SOURCE, "target": TARGET}
    return field(name, **(known | changes), spacing=0.5)


def test_each_field_by_hand():
    """Distances, steps, neighbours and shared targets of four particles."""
    np.testing.assert_allclose(values("displacement"), 5)
    np.testing.assert_allclose(values("speed"), np.sqrt(20), rtol=1e-6)
    np.testing.assert_allclose(values("speed", previous=None), 5)
    far = np.linalg.norm(POSITIONS[3] - TARGET[1])
    np.testing.assert_allclose(values("target_distance"), [0, 1, 0.25, far], rtol=1e-6)
    np.testing.assert_array_equal(values("target_hits"), [2, 2, 2, 2])
    near = np.linalg.norm(POSITIONS[3] - POSITIONS[2])
    np.testing.assert_allclose(values("overlap"), [2, 2, 2, 2 * near], rtol=1e-6)
    np.testing.assert_array_equal(values("det_f", det_f=[1, 2, 3, 4]), [1, 2, 3, 4])


def test_coincident_particles_have_no_distance():
    """Copies of a particle have a neighbour at distance 0, however many there are."""
    crowd = np.repeat(POSITIONS, [20, 1, 1, 1], axis=0)
    source = np.zeros_like(crowd)
    overlap = field(
        "overlap", positions=crowd, previous=None, source=source, target=TARGET, spacing=1.0
    )
    np.testing.assert_array_equal(overlap[:20], 0)
    assert (overlap[20:] > 0).all()


def test_density_compares_with_the_target(lattice_ball):
    """1 on the target's own lattice, where a corner may look thin; 2 where each is double."""
    ball = lattice_ball(4.0, 1 / 3)
    same = {"previous": None, "source": ball, "target": ball}
    even = field("density", positions=ball, **same)
    deep = np.linalg.norm(ball, axis=1) < 3
    np.testing.assert_allclose(even[deep], 1)
    assert even.min() > 0.75
    count = np.count_nonzero(deep)
    points = np.concatenate([ball[deep], ball[deep], ball[~deep]])
    doubled = field("density", positions=points, **same)[:count]
    deepest = np.linalg.norm(ball[deep], axis=1) < 1.9  # their whole neighbourhood is double
    expected = 2 * len(ball) / (len(ball) + count)
    np.testing.assert_allclose(doubled[deepest], expected, rtol=1e-5)


@pytest.mark.parametrize("name", [name for name in FIELDS if name != "det_f"])
def test_particle_without_position_has_no_value(name):
    """NaN for it, and the others are as if it were not there."""
    lost = POSITIONS.copy()
    lost[1] = np.nan
    found = values(name, positions=lost)
    assert found.dtype == np.float32
    assert np.isnan(found).tolist() == [False, True, False, False]


def test_refusals_name_cause_and_remedy():
    """An unknown field suggests one; det F that is not stored says who stores it."""
    with pytest.raises(ConfigError, match="'speed'"):
        values("sped")
    with pytest.raises(ResultError, match="by flow, transport, joint and physics"):
        values("det_f")
