"""Colours of the matter: those of its first shape, which become those of the next.

A point of the matter has a place in each shape of the run, and takes the colour of the nearest
point of the shape's surface there. Between two shapes both colours are mixed in linear light, as
lamps mix, along a curve that rests at either end. A shape without colours is of clay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morph_engine import srgb
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.mesh_colors import nearest_colors
from morph_engine.geometry.placement import placed
from morph_engine.geometry.surface_tracking import carried
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import SpoolReader
from morph_engine.smoothstep import smoothstep


def blended(one: srgb.Light, other: srgb.Light, share: float) -> srgb.Light:
    """Colours after a share of the way from one shape to the next, linear light, shape [n, 3]."""
    return one + smoothstep(share) * (other - one)


def colors_in_shape(run: RunRecord, stop: int, points: ArrayLike) -> srgb.Light:
    """Colours that points of the matter have in a shape of a run.

    Args:
        run: The run.
        stop: Index of the shape, 0 for the source.
        points: Where the points are while the matter has that shape [dx], shape [n, 3].

    Returns:
        Linear light, shape [n, 3], float64.
    """
    shape = run.stops[stop]
    if not isinstance(shape, Mesh) or shape.colors is None:
        return np.tile(srgb.linear(srgb.CLAY), (len(np.asarray(points)), 1))
    mesh = placed(shape, run.placement.stops[stop])
    return nearest_colors(points, mesh.vertices, mesh.faces, shape.colors)


@dataclass(frozen=True, eq=False)
class Passage:
    """The way from one shape of a run to the next, at one moment.

    Attributes:
        run: The run.
        leg: Index of the leg.
        share: Share of it that is done, 0 to 1.
        positions: Of the particles at the moment [dx], shape [n, 3].
        begin: Of the particles in the shape before [dx], shape [n, 3].
        end: Of the particles in the shape to come [dx], shape [n, 3].
    """

    run: RunRecord
    leg: int
    share: float
    positions: NDArray[np.floating]
    begin: NDArray[np.floating]
    end: NDArray[np.floating]

    def colors_at(self, vertices: NDArray[np.float64], spacing: float) -> NDArray[np.uint8]:
        """Colours of a surface around the particles.

        Its corners are carried with the particles to where they were and will be, so that colours
        are finer than the particles, and exact at the corners in both shapes.

        Args:
            vertices: Corners of the surface [dx], shape [v, 3].
            spacing: Lattice spacing h of the particles at the moment [dx].

        Returns:
            sRGB, shape [v, 3], uint8.
        """
        return self.colors_between(*self.carried_to_ends(vertices, spacing))

    def carried_to_ends(
        self, vertices: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where corners of a surface are in both shapes [dx]; arguments as for `colors_at`."""
        begin, here, end = (
            np.asarray(points, np.float64) for points in (self.begin, self.positions, self.end)
        )
        return carried(vertices, here, begin, spacing), carried(vertices, here, end, spacing)

    def colors_between(
        self, begin: NDArray[np.float64], end: NDArray[np.float64]
    ) -> NDArray[np.uint8]:
        """Colours at points of which the places in both shapes are known.

        Args:
            begin: In the shape before [dx], shape [v, 3].
            end: In the shape to come, likewise.

        Returns:
            sRGB, shape [v, 3], uint8.
        """
        one, other = (
            colors_in_shape(self.run, self.leg + step, places)
            for step, places in enumerate((begin, end))
        )
        return srgb.to_bytes(blended(one, other, self.share))


def particle_colors(run: SpoolReader) -> NDArray[np.uint8] | None:
    """Colours of the particles in each shape that they have come to, or are on their way to.

    On a leg that has not ended, its last frame stands for the end.

    Returns:
        sRGB, shape [stops, n, 3], uint8; None where no shape has colours.

    Raises:
        ResultError: A frame is damaged.
    """
    if not run.run.colored:
        return None
    legs = run.leg_of(run.frame_count - 1) + 1 if run.frame_count else 0
    return np.stack(
        [
            srgb.to_bytes(colors_in_shape(run.run, stop, run.positions_in_shape(stop)))
            for stop in range(legs + 1)
        ]
    )
