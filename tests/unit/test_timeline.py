"""Playing time: how long, how fast, where it rests, how it repeats."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from morph_engine.errors import ConfigError
from morph_engine.results.timeline import Moment, Timing, moments

DISTANCES = [0.1, 1.0, 2.0, 0.1, 0.2, 2.0, 0.5, 0.01]
"""Of two legs of four frames, each with little motion at its ends."""

STOPS = [0, 4, 8]


def places(found: list[Moment]) -> np.ndarray:
    """Where moments are, as the distance from the beginning."""
    travelled = np.concatenate([[0.0], np.cumsum(DISTANCES)])
    return np.array([sum(weight * travelled[index] for index, weight in m.weights) for m in found])


def test_seconds_and_rate_make_pictures_from_the_first_shape_to_the_last() -> None:
    """3 s at 30 frames a second are 90 pictures; the shares of stations sum to one."""
    found = moments(DISTANCES, STOPS, Timing(3, 30, easing="linear"))
    assert len(found) == 90
    assert found[0].weights == ((0, 1.0),) and found[-1].weights == ((8, 1.0),)
    assert all(sum(weight for _, weight in m.weights) == pytest.approx(1) for m in found)
    assert [m.leg for m in found] == sorted(m.leg for m in found)
    assert len(moments(DISTANCES, STOPS, Timing(fps=10, hold=0.5))) == 9 + 15


def test_an_even_pace_has_no_change_of_speed_where_legs_meet() -> None:
    """From picture to picture matter moves equally far, however frames were spaced.

    Each leg has a whole number of pictures, so that its shape is seen as it is.
    """
    found = moments(DISTANCES, STOPS, Timing(3, 30, easing="linear"))
    speed, leg = np.diff(places(found)), np.array([moment.leg for moment in found[1:]])
    for one in (0, 1):
        assert np.ptp(speed[leg == one]) < 1e-6 * speed.mean()
    assert np.ptp(speed) < speed.mean() / np.bincount(leg).min()
    met = places(found)[np.flatnonzero(leg == 0)[-1] + 1]
    assert met == pytest.approx(sum(DISTANCES[:4]), rel=1e-6)


@pytest.mark.parametrize("easing", ["in-out", "overshoot"])
def test_eased_legs_begin_and_end_without_speed(easing) -> None:
    """Each stop is passed at less than a tenth of the mean speed."""
    found = moments(DISTANCES, STOPS, Timing(20, 30, easing=easing))
    speed = np.abs(np.diff(places(found)))
    meeting = next(i for i, m in enumerate(found) if m.leg == 1)
    for index in (0, meeting - 2, meeting - 1, len(speed) - 1):
        assert speed[index] < 0.1 * speed.mean()


def test_overshoot_goes_past_the_end_of_a_leg_and_returns() -> None:
    """By about 5 % of the leg; other paces stay within it."""
    for easing, most in (("in-out", 0.0), ("linear", 0.0), ("overshoot", 0.053)):
        found = moments(DISTANCES, STOPS, Timing(20, 30, easing=easing))
        length = sum(DISTANCES[:4])
        beyond = max(p for p, m in zip(places(found), found, strict=True) if m.leg == 0) - length
        assert beyond == pytest.approx(most * length, abs=2e-3 * length)


def test_shapes_rest_at_the_stops() -> None:
    """Half a second at each of three stops: 15 pictures of 30 a second."""
    found = moments(DISTANCES, STOPS, Timing(4, 30, hold=0.5, easing="linear"))
    at = places(found)
    length = sum(DISTANCES)
    for stop in (0.0, sum(DISTANCES[:4]), length):
        assert 14 <= np.isclose(at, stop, atol=1e-6).sum() <= 16


def test_a_loop_closes_and_ping_pong_returns() -> None:
    """Both end where they begin and rest there once; a loop needs a run that comes back."""
    loop = moments(DISTANCES, STOPS, Timing(3, 30, repeat="loop"), closed=True)
    assert loop[0] == loop[-1]
    assert loop[45].closing == 0 and loop[-2].closing > 0.95
    assert all(a.closing <= b.closing for a, b in pairwise(loop[:-1]))
    there = moments(DISTANCES, STOPS, Timing(3, 30, hold=0.1, repeat="ping-pong"))
    assert there[0].weights == there[-1].weights
    assert max(places(there)) == pytest.approx(sum(DISTANCES))
    with pytest.raises(ConfigError, match="returns to its first shape"):
        moments(DISTANCES, STOPS, Timing(3, 30, repeat="loop"))


@pytest.mark.parametrize("wrong", [{"seconds": 0}, {"seconds": 4000}, {"fps": 0.5}, {"hold": -1}])
def test_numbers_out_of_range_are_refused(wrong) -> None:
    """Each with what may be used."""
    with pytest.raises(ConfigError):
        Timing(**wrong)


def test_rests_that_leave_no_time_are_refused() -> None:
    """Three rests of a second do not go into three seconds."""
    with pytest.raises(ConfigError, match="3 pauses of 1 s leave no time"):
        moments(DISTANCES, STOPS, Timing(3, 30, hold=1))
