"""The particles of a result at any moment of its playing time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morph_engine.optimal_transport.plan import transport_plan
from morph_engine.results.timeline import Moment, Timing, duration, moments, picture_count
from morph_engine.results.trajectory import Trajectory

Floats = NDArray[np.float64]

KEPT_STATIONS = 6


class Playback:
    """A result that is played.

    Where a loop closes, each particle takes the place of another one of the first frame, near to
    where it has come: so the last picture is the first one.

    Args:
        trajectory: The result, of one frame at least.
        timing: How it is played.

    Attributes:
        moments: What is shown, a moment per picture.
        seconds: When the last of them is shown, after the first [s].

    Raises:
        ConfigError: The timing does not go with the run.
        ResultError: A frame is damaged.
    """

    def __init__(self, trajectory: Trajectory, timing: Timing) -> None:
        self._trajectory = trajectory
        self._station = lru_cache(KEPT_STATIONS)(self._read)
        self._distance = lru_cache(None)(self._moved)
        complete = trajectory.status == "complete"
        closed = complete and trajectory.run.closed
        self.seconds: float = duration(stops(trajectory), timing)
        self.moments: list[Moment] = self._moments(timing, closed=closed)

    def _moments(self, timing: Timing, *, closed: bool) -> list[Moment]:
        """What is shown, along stations that lie at least the way of a picture apart.

        Matter that settles goes to and fro between nearer ones: that way would take time in which
        hardly anything is seen to move.
        """
        shapes = stops(self._trajectory)
        way = sum(self._distances(range(self._trajectory.frame_count + 1)))
        passes = 2 if timing.repeat == "ping-pong" else 1
        kept = self._apart(passes * way / picture_count(shapes, timing), shapes)
        timing = replace(timing, seconds=self.seconds)  # fewer stations take as long
        places = [kept.index(stop) for stop in shapes]
        return [
            replace(
                moment,
                weights=tuple((kept[index], weight) for index, weight in moment.weights),
                station=float(np.interp(moment.station, range(len(kept)), kept)),
            )
            for moment in moments(self._distances(kept), places, timing, closed=closed)
        ]

    def positions(self, moment: Moment) -> Floats:
        """Particle positions [dx], shape [n, 3], float64, in the order of the source."""
        blended: Floats = sum(
            (weight * self._station(index) for index, weight in moment.weights), np.zeros(())
        )
        if moment.closing:
            last = self._station(self._trajectory.frame_count)
            blended += moment.closing * (self._station(0)[self._partner] - last)
        return blended

    def values(self, moment: Moment, values: ArrayLike) -> Floats:
        """Values of the particles, shape [n, ...], which become those of the first frame."""
        return self.closed(moment, values, values)

    def closed(self, moment: Moment, last: ArrayLike, first: ArrayLike) -> Floats:
        """Values of the particles in the last shape, which become those in the first one.

        Both have shape [n, ...].
        """
        array = np.asarray(last, np.float64)
        if not moment.closing:
            return array
        return array + moment.closing * (np.asarray(first, np.float64)[self._partner] - array)

    def frames(self, moment: Moment) -> list[tuple[int, float]]:
        """Frames of a moment and their shares; the first frame stands for the source as well."""
        return [(max(index - 1, 0), weight) for index, weight in moment.weights]

    @cached_property
    def _partner(self) -> NDArray[np.intp]:
        """Whose place in the source each particle takes in the end, a permutation, shape [n]."""
        return transport_plan(self._station(self._trajectory.frame_count), self._station(0))

    def _read(self, station: int) -> Floats:
        trajectory = self._trajectory
        positions = trajectory.positions(station - 1) if station else trajectory.run.source_points
        return np.asarray(positions, np.float64)

    def _distances(self, stations: Sequence[int]) -> list[float]:
        """What particles move on average from station to station [dx]."""
        return [self._distance(one, other) for one, other in pairwise(stations)]

    def _moved(self, one: int, other: int) -> float:
        """What particles move on average between two stations [dx]; lost ones left out."""
        lengths = np.linalg.norm(self._station(other) - self._station(one), axis=1)
        finite = lengths[np.isfinite(lengths)]
        return float(finite.mean()) if len(finite) else 0.0

    def _apart(self, way: float, shapes: Sequence[int]) -> list[int]:
        """The stations of the shapes, and between them others that lie at least so far apart."""
        kept = [0]
        for station in range(1, self._trajectory.frame_count + 1):
            near = self._distance(kept[-1], station) < way
            if near and station in shapes and kept[-1] not in shapes:
                kept.pop()
            if not near or station in shapes:
                kept.append(station)
        return kept


def stops(trajectory: Trajectory) -> list[int]:
    """Stations at which a result has a shape, or has come to its end."""
    ends = np.flatnonzero(np.diff(trajectory.legs)) + 1
    return [0, *map(int, ends), trajectory.frame_count]


def picture_table(trajectory: Trajectory, timing: Timing) -> dict[str, Any]:
    """What a player needs that has the frames of a result but not its source.

    Returns:
        ``fps``, pictures per second; ``repeat``, whether it goes on from its beginning; and
        ``frames``, the frame of each picture, or the place between two: the first for the source,
        and the end of a leg where that is passed. A loop ends with its last frame, and has
        ``closing``: how far each picture has gone from that to the first one, 0 to 1.

    Raises:
        ConfigError: The timing does not go with the run.
        ResultError: A frame is damaged.
    """
    moments = Playback(trajectory, timing).moments
    table: dict[str, Any] = {
        "fps": timing.fps,
        "repeat": timing.repeat != "none",
        "frames": [round(max(moment.station - 1, 0.0), 4) for moment in moments],
    }
    if timing.repeat == "loop":
        table["frames"][-1] = trajectory.frame_count - 1
        table["closing"] = [*(round(moment.closing, 4) for moment in moments[:-1]), 1.0]
    return table
