"""Like parts of two shapes: which belong together, and how matter follows them on its way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import lazy_loader as lazy
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import flow, kept_results
from morph_engine.errors import ConfigError
from morph_engine.methods.method import Problem
from morph_engine.optimization.watchdog import Event
from morph_engine.sections import Section, Vector

threadpoolctl: Any = lazy.load("threadpoolctl")

LARGEST_DISTORTION = 0.15
"""Geodesic distortion below which two shapes are taken to have like parts."""

LANDMARK_REACH = 1.0
"""Landmarks lie at most so far from the matter of their shape, and lead what is so near [dx]."""

RETURN = 0.3
"""Share of its distance from where the warp wants it that a particle is to make in a frame."""

ENDS = ("source", "target")
"""Of a correspondence."""


class Landmark(Section):
    """A point of the source and where it belongs, in the coordinates of the two shapes."""

    source: Vector
    target: Vector
    name: str = Field("", max_length=60, description="For your own use.")


class LikeParts:
    """What carries parts of the source to like parts of the target.

    Args:
        problem: The two shapes.
        choice: Whether parts are carried; `auto`: where the best matching distorts little.
        landmarks: Points that are met at the end; with any, parts are carried.

    Attributes:
        warp: What carries them; None where nothing does.

    Raises:
        ConfigError: A landmark is not at its shape.
    """

    def __init__(
        self,
        problem: Problem,
        choice: Literal["auto", "on", "off"],
        landmarks: Sequence[Landmark],
    ) -> None:
        self._problem = problem
        self._landmarks = landmarks
        self._found = self._match() if choice != "off" or landmarks else None
        source = problem.source.astype(np.float64)
        self.warp: flow.Warp | None = None
        if self._found and (
            choice == "on" or landmarks or self._found.distortion < LARGEST_DISTORTION
        ):
            self.warp = flow.Warp(self._found)
            self._followed = self.warp.follow(source)
            self._held = self._closeness(source)
        self._carried_share = -1.0

    def decisions(self) -> list[Event]:
        """What was decided, for the events of the first frame."""
        found = self._found
        if found is None:
            return []
        message = (
            f"Parts are {'' if self.warp else 'not '}carried to like parts: matched geodesic "
            f"distances differ by {found.distortion:.1%} of their mean."
        )
        data = {"distortion": found.distortion, "plain_distortion": found.plain_distortion}
        return [Event(0, "correspondence", message, data)]

    def step(
        self, positions: NDArray[np.floating[Any]], share: float, next_share: float
    ) -> NDArray[np.float64]:
        """What the warp asks particles to move in a frame [dx], shape [n, 3].

        Args:
            positions: Where they are [dx], shape [n, 3].
            share: Share of the way before the frame.
            next_share: And after it.
        """
        here = self._carried if share == self._carried_share else self._carry(share)
        there = self._carry(next_share)
        pull = np.maximum(RETURN * (1 - share), self._held)
        step: NDArray[np.float64] = there - here + pull[:, None] * (here - positions)
        return step

    def _carry(self, share: float) -> NDArray[np.float64]:
        """Where the warp wants the particles at a share of the way [dx], shape [n, 3]."""
        assert self.warp
        self._carried, self._carried_share = self.warp.forward(self._followed, share), share
        return self._carried

    def _closeness(self, source: NDArray[np.float64]) -> NDArray[np.float64]:
        """How close particles are to a landmark, 1 at it, shape [n]: these follow the warp."""
        assert self.warp
        if not self._landmarks:
            return np.zeros(len(source))
        marks = self.warp.start[: len(self._landmarks)]
        distance = np.min([np.linalg.norm(source - mark, axis=1) for mark in marks], axis=0)
        close: NDArray[np.float64] = np.exp(-((distance / LANDMARK_REACH) ** 2))
        return close

    def _match(self) -> flow.Correspondence:
        problem, marks = self._problem, self._landmarks
        placed = (
            _placed([mark.source for mark in marks], problem.source_to_grid, problem.source),
            _placed([mark.target for mark in marks], problem.target_to_grid, problem.target),
        )
        found = kept_results.kept(
            "correspondence",
            (problem.source, problem.target, problem.config.spacing, *placed),
            lambda: _arrays(self._match_anew(*placed)),
        )
        return _correspondence(found)

    def _match_anew(
        self, source_marks: NDArray[np.float64], target_marks: NDArray[np.float64]
    ) -> flow.Correspondence:
        """Like parts of the shapes, given where their landmarks are [dx], each shape [k, 3]."""
        source, target = (
            flow.sample_controls(points.astype(np.float64), self._problem.config.spacing, marks)
            for points, marks in (
                (self._problem.source, source_marks),
                (self._problem.target, target_marks),
            )
        )
        with threadpoolctl.threadpool_limits(1, "blas"):  # matrices are small: threads only wait
            return flow.match(source, target)


def _arrays(found: flow.Correspondence) -> kept_results.Arrays:
    """A correspondence as arrays by name."""
    ends = {
        f"{end}_{name}": value for end in ENDS for name, value in vars(getattr(found, end)).items()
    }
    numbers = {"plan": found.plan, "distortion": found.distortion}
    return {
        name: np.asarray(value)
        for name, value in (ends | numbers | {"plain_distortion": found.plain_distortion}).items()
    }


def _correspondence(arrays: kept_results.Arrays) -> flow.Correspondence:
    """The correspondence of which `_arrays` has made arrays."""
    source, target = (
        flow.Controls(
            points=arrays[f"{end}_points"],
            weights=arrays[f"{end}_weights"],
            geodesic=arrays[f"{end}_geodesic"],
            scale=float(arrays[f"{end}_scale"]),
            landmark_count=int(arrays[f"{end}_landmark_count"]),
        )
        for end in ENDS
    )
    distortions = float(arrays["distortion"]), float(arrays["plain_distortion"])
    return flow.Correspondence(source, target, arrays["plan"], *distortions)


def _placed(
    marks: list[Vector], to_grid: NDArray[np.float64], points: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Landmarks in grid units, shape [k, 3].

    Raises:
        ConfigError: One is not at the shape.
    """
    placed = np.array(marks, np.float64).reshape(-1, 3) @ to_grid[:3, :3].T + to_grid[:3, 3]
    lower, upper = (points.min(axis=0), points.max(axis=0))
    for mark, place in zip(marks, placed, strict=True):
        distance = float(np.linalg.norm(points - place, axis=1).min())
        if distance > LANDMARK_REACH:
            to_user = np.linalg.inv(to_grid)
            corners = np.array([lower, upper]) @ to_user[:3, :3].T + to_user[:3, 3]
            lowest, highest = (", ".join(f"{x:.4g}" for x in corner) for corner in corners)
            raise ConfigError(
                f"The landmark {', '.join(f'{x:g}' for x in mark)} lies {distance:.1f} grid units "
                f"outside the shape, which reaches from ({lowest}) to ({highest}).",
                "Give it in the coordinates of the mesh, on its surface or inside.",
            )
    return placed
