"""Like parts of two shapes: which belong together, and how matter follows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import flow, geometry, kept_results, metrics
from morph_engine.blas_threads import one_blas_thread
from morph_engine.errors import ConfigError
from morph_engine.methods.method import Problem
from morph_engine.optimization.watchdog import Event
from morph_engine.sections import Section, Vector

if TYPE_CHECKING:
    from morph_engine.geometry.mesh import Mesh

LARGEST_MISMATCH = 1.0
"""Mismatch below which a source is taken to have been carried to its target."""

LEAST_CONTROLS = 5
"""Shapes of fewer controls, of some fifty particles, have no parts."""

RETURN = 0.3
"""Share of its distance from where the warp wants it that a particle is to make in a frame."""

LANDMARK_REACH = 1.0
"""Landmarks lie on the mesh of their shape or at most so far from its matter, and lead what is so
near [dx]."""

ON_SURFACE = 0.1
"""What is so near to a mesh lies on it, in coordinates that were rounded [dx]."""


class Landmark(Section):
    """A point of the source and where it belongs, in the coordinates of the two shapes."""

    source: Vector
    target: Vector
    name: str = Field("", max_length=60, description="A name of your choice.")


class LikeParts:
    """What carries parts of the source to like parts of the target.

    Args:
        problem: The two shapes.
        choice: Whether parts are carried; `auto`: where the target is met by that.
        landmarks: Points that are met at the end; with any, parts are carried. One on the mesh
            where no particle is near, as at a sharp tip, stands for the nearest particle.

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
        self._found: flow.Registration | None = None
        self.warp: flow.Warp | None = None
        if choice != "off" or landmarks:
            with one_blas_thread():
                controls, target = self._both()
                if min(len(controls.points), len(target.points)) >= LEAST_CONTROLS:
                    self._found = found = self._register(controls, target)
                    if choice == "on" or landmarks or found.mismatch < LARGEST_MISMATCH:
                        source = problem.source.astype(np.float64)
                        self.warp = flow.Warp(controls, found)
                        self._followed = self.warp.follow(source)
                        self._held = self._closeness(source)
        self._carried_share = -1.0

    def decisions(self) -> list[Event]:
        """What was decided, for the events of the first frame."""
        found = self._found
        if found is None:
            return []
        message = (
            f"Parts are {'' if self.warp else 'not '}carried to similar parts: the "
            f"carried source differs from the target by {found.mismatch:.2f} control "
            f"spacings, with a strain of {found.strain:.2f}."
        )
        data = {"mismatch": found.mismatch, "strain": found.strain}
        return [Event(0, "registration", message, data)]

    def step(
        self, positions: NDArray[np.floating[Any]], share: float, next_share: float
    ) -> NDArray[np.float64]:
        """What the warp asks particles to move in a frame [dx], shape [n, 3].

        Args:
            positions: Where they are [dx], shape [n, 3].
            share: Share of the change before the frame.
            next_share: And after it.
        """
        here = self._carried if share == self._carried_share else self._carry(share)
        there = self._carry(next_share)
        pull = np.maximum(RETURN * (1 - share), self._held)
        step: NDArray[np.float64] = there - here + pull[:, None] * (here - positions)
        return step

    def _carry(self, share: float) -> NDArray[np.float64]:
        """Where the warp wants the particles at a share of the change [dx], shape [n, 3]."""
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

    def _both(self) -> list[flow.Controls]:
        """Controls of the source and of the target."""
        problem, marks = self._problem, self._landmarks
        return [
            self._controls(
                points, _placed([getattr(mark, end) for mark in marks], to_grid, points, mesh)
            )
            for end, points, to_grid, mesh in (
                ("source", problem.source, problem.source_to_grid, problem.source_mesh),
                ("target", problem.target, problem.target_to_grid, problem.target_mesh),
            )
        ]

    def _register(self, source: flow.Controls, target: flow.Controls) -> flow.Registration:
        """Where the controls of the source belong."""
        growth = (len(self._problem.target) / len(self._problem.source)) ** (1 / 3)
        arrays = kept_results.kept(
            "registration",
            (*vars(source).values(), *vars(target).values(), growth),
            lambda: _arrays(flow.register(source, target, growth)),
        )
        return flow.Registration(
            arrays["images"], float(arrays["mismatch"]), float(arrays["strain"])
        )

    def _controls(
        self, points: NDArray[np.float32], landmarks: NDArray[np.float64]
    ) -> flow.Controls:
        """Controls of a shape, given where its landmarks are [dx], shape [k, 3]."""
        spacing = self._problem.config.spacing
        arrays = kept_results.kept(
            "controls",
            (points, spacing, landmarks),
            lambda: _arrays(flow.sample_controls(points.astype(np.float64), spacing, landmarks)),
        )
        return flow.Controls(
            arrays["points"],
            arrays["form"],
            arrays["weights"],
            int(arrays["landmark_count"]),
        )


def _arrays(found: flow.Controls | flow.Registration) -> kept_results.Arrays:
    """What was found, as arrays by name."""
    return {name: np.asarray(value) for name, value in vars(found).items()}


def _placed(
    marks: list[Vector],
    to_grid: NDArray[np.float64],
    points: NDArray[np.float32],
    mesh: Mesh | None,
) -> NDArray[np.float64]:
    """Landmarks in grid units, shape [k, 3].

    One on or in the mesh that is farther than `LANDMARK_REACH` from all matter, as at a sharp tip,
    is moved to the nearest particle.

    Raises:
        ConfigError: One is not at the shape.
    """
    placed = np.array(marks, np.float64).reshape(-1, 3) @ to_grid[:3, :3].T + to_grid[:3, 3]
    for index, (mark, place) in enumerate(zip(marks, placed, strict=True)):
        distances = np.linalg.norm(points - place, axis=1)
        distance = float(distances.min())
        if distance <= LANDMARK_REACH:
            continue
        if mesh:
            distance = metrics.outside_metrics(place[None], mesh)["outside_max"]
        if mesh and distance <= ON_SURFACE:
            placed[index] = points[distances.argmin()]
            continue
        to_user = np.linalg.inv(to_grid)
        own = (mesh.vertices if mesh else points) @ to_user[:3, :3].T + to_user[:3, 3]
        lowest, highest = (", ".join(f"{x:.4g}" for x in corner) for corner in geometry.extent(own))
        raise ConfigError(
            f"The landmark {', '.join(f'{x:g}' for x in mark)} lies {distance:.1f} grid units "
            f"outside the shape, which reaches from ({lowest}) to ({highest}).",
            "Give a point in the coordinates of the mesh, on its surface or inside.",
        )
    return placed
