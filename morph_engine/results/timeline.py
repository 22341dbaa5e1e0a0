"""Playing time: which moment of a run is shown when, apart from how many frames were computed.

A run passes through stations: the source is station 0, and frame k is station k + 1. Between two of
them particles move in straight lines. The pace is that of the matter: time goes with the mean
distance that particles move, so that matter moves evenly however the frames were spaced. A picture
shows each of the stops, the shapes that the run goes through, and matter stands still there if it
is to rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from morph_engine.errors import ConfigError
from morph_engine.smoothstep import smoothstep

Easing = Literal["linear", "in-out", "overshoot"]
Repeat = Literal["none", "loop", "ping-pong"]

Floats = NDArray[np.float64]

FRAMES_PER_SECOND = 30.0

OVERSHOOT = 1.2
"""How far `overshoot` goes: 5 % of a leg beyond its end."""

CLOSING = 0.4
"""Share of the last leg in which particles of a loop take the places of the beginning."""

INSTANT = 1e-9
"""What rounding may add to a time [s]."""

LEAST_DISTANCE = 1e-9
"""Added to the distance between two stations, so that each has a time of its own [dx]."""


@dataclass(frozen=True)
class Timing:
    """How a run is played.

    Attributes:
        seconds: Duration of all, with the rests [s]; None for as long as the frames take at `fps`,
            and the rests.
        fps: Pictures per second.
        hold: How long a shape rests at each stop [s].
        easing: Pace on a leg: ``linear`` is even, without a change of speed from one leg to the
            next; ``in-out`` starts and ends slowly; ``overshoot`` goes past the end and returns.
        repeat: ``loop`` ends as it begins, for runs that come back to their first shape;
            ``ping-pong`` plays to the end and back.

    Raises:
        ConfigError: A number is out of range.
    """

    seconds: float | None = None
    fps: float = FRAMES_PER_SECOND
    hold: float = 0.0
    easing: Easing = "in-out"
    repeat: Repeat = "none"

    @classmethod
    def of(cls, *, fps: float | None, **asked: Any) -> Timing | None:
        """A timing by what is asked for; None where nothing but a rate is.

        Args:
            fps: Pictures per second; None for the usual rate.
            asked: Other attributes by name; None for the usual ones.

        Raises:
            ConfigError: A number is out of range.
        """
        given = {name: value for name, value in asked.items() if value is not None}
        if not given:
            return None
        return cls(**given, fps=fps or FRAMES_PER_SECOND)

    def __post_init__(self) -> None:
        if self.seconds is not None and not 0 < self.seconds <= 3600:
            raise ConfigError(
                f"A playing time of {self.seconds:g} s is out of range.",
                "Use more than 0 and at most 3600.",
            )
        if not 1 <= self.fps <= 120:
            raise ConfigError(f"{self.fps:g} frames per second is out of range.", "Use 1 to 120.")
        if not 0 <= self.hold <= 600:
            raise ConfigError(
                f"A pause of {self.hold:g} s is out of range.", "Use 0 to 600 seconds."
            )


@dataclass(frozen=True)
class Moment:
    """What is shown at a time.

    Attributes:
        weights: Stations and the shares with which their particles make those of the moment; they
            sum to 1. A share is negative where the moment lies beyond the end of a leg.
        station: The place between stations, at most the end of the leg.
        leg: Index of the leg.
        closing: How far particles have gone to the places of the beginning, 0 to 1. The last moment
            of a loop is the first one.
    """

    weights: tuple[tuple[int, float], ...]
    station: float
    leg: int
    closing: float = 0.0


def duration(stops: Sequence[int], timing: Timing) -> float:
    """How long a film is [s]: as asked for, or as its frames take one picture each.

    Args:
        stops: Stations of the shapes, from 0 to the last station.
        timing: How the run is played.
    """
    if timing.seconds is not None:
        return timing.seconds
    pictures = _steps_between(_visited(stops, timing)) + 1
    return pictures / timing.fps + _rests(stops, timing) * timing.hold


def picture_count(stops: Sequence[int], timing: Timing) -> int:
    """Number of pictures of a film; arguments as of `duration`."""
    return max(2, round(duration(stops, timing) * timing.fps))


def moments(
    distances: Sequence[float] | Floats,
    stops: Sequence[int],
    timing: Timing,
    *,
    closed: bool = False,
) -> list[Moment]:
    """The moments of a film, one per picture, the first and the last shape included.

    Args:
        distances: What particles move on average from each station to the next [dx], shape
            [stations - 1].
        stops: Stations of the shapes, from 0 to the last station.
        timing: How the run is played.
        closed: Whether the last shape is the first one.

    Raises:
        ConfigError: The rests take longer than all, or a loop is asked for that does not close.
    """
    if timing.repeat == "loop" and not closed:
        raise ConfigError(
            "A loop needs a run that returns to its first shape, and this one does not.",
            "Play it as ping-pong, or make a run whose last target is its first shape.",
        )
    steps = np.asarray(distances, np.float64) + LEAST_DISTANCE
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    visited, rests = _visited(stops, timing), _rests(stops, timing)
    seconds = duration(stops, timing)
    moving = seconds - rests * timing.hold
    if moving <= 0:
        raise ConfigError(
            f"{rests} pauses of {timing.hold:g} s leave no time for motion in {seconds:g} s.",
            "Choose a longer playing time (`seconds`) or shorter pauses (`hold`).",
        )
    total = sum(abs(travelled[b] - travelled[a]) for a, b in pairwise(visited))
    count = picture_count(stops, timing)
    ease, schedule, clock = _EASINGS[timing.easing], [], 0.0
    for a, b in pairwise(visited):
        begin = clock + timing.hold
        clock = begin + moving * abs(travelled[b] - travelled[a]) / total
        schedule.append((begin, clock, a, b))
    if not timing.hold:
        schedule = _on_pictures(schedule, seconds / (count - 1))
    closing = CLOSING if timing.repeat == "loop" else 0.0
    found = []
    for time in np.linspace(0.0, seconds, count):
        leg = next((i for i, (_, end, _, _) in enumerate(schedule) if time < end + INSTANT), -1)
        begin, end, a, b = schedule[leg]
        share = ease(float(np.clip((time - begin) / (end - begin), 0, 1)))
        last = b == visited[-1]
        found.append(_moment(travelled, stops, a, b, share, closing if last else 0.0))
    if timing.repeat == "loop":
        found[-1] = found[0]
    return found


def _visited(stops: Sequence[int], timing: Timing) -> list[int]:
    """The shapes as they are passed."""
    return [*stops, *(stops[-2::-1] if timing.repeat == "ping-pong" else [])]


def _rests(stops: Sequence[int], timing: Timing) -> int:
    """How often there is a rest; what repeats rests once where it begins."""
    return len(_visited(stops, timing)) - (timing.repeat != "none")


def _on_pictures(
    schedule: list[tuple[float, float, int, int]], apart: float
) -> list[tuple[float, float, int, int]]:
    """Legs that begin and end with a picture, which so shows the shape there as it is.

    Pictures on either side of a shape from which matter turns back would hardly differ.
    """
    places = [0, *(round(end / apart) for _, end, _, _ in schedule)]
    if any(second <= first for first, second in pairwise(places)):
        return schedule  # fewer pictures than legs
    return [
        (first * apart, second * apart, a, b)
        for (first, second), (_, _, a, b) in zip(pairwise(places), schedule, strict=True)
    ]


def _steps_between(visited: Sequence[int]) -> int:
    """Number of steps between stations on a path from stop to stop."""
    return sum(abs(b - a) for a, b in pairwise(visited))


def _moment(
    travelled: Floats, stops: Sequence[int], a: int, b: int, share: float, closing: float
) -> Moment:
    """The moment after a share of the path from stop a to stop b, which may be more than all."""
    leg = list(stops).index(min(a, b))
    within = min(share, 2 - share)  # beyond its end a path goes on as its mirror image
    place = travelled[a] + within * (travelled[b] - travelled[a])
    station = float(np.interp(place, travelled, np.arange(len(travelled))))
    below = min(int(station), len(travelled) - 2)
    weights = [(below, 1 - (station - below)), (below + 1, station - below)]
    if share > 1:
        weights = [(b, 2.0), *((index, -weight) for index, weight in weights)]
        station = float(b)
    closed = smoothstep((share - 1 + closing) / closing) if closing else 0.0
    kept = tuple((index, weight) for index, weight in weights if weight)
    return Moment(kept, station, leg, closed)


def _overshot(share: float) -> float:
    """From 0 to 1 and beyond, and back to 1, without speed at either end."""
    left = smoothstep(share) - 1
    return 1 + left * left * ((OVERSHOOT + 1) * left + OVERSHOOT)


_EASINGS: dict[Easing, Callable[[float], float]] = {
    "linear": lambda share: share,
    "in-out": smoothstep,
    "overshoot": _overshot,
}
