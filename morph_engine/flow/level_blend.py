"""What lies between two shapes: a blend of their signed distances, rounded in between.

At the share s the level is (1 - s) f(phi_0) + s f(phi_1), of the signed distances phi_0 and phi_1::

    f(d) = L log(1 + d / L)             outside: far parts come and go at an even pace
    f(d) = d - K (1 - exp(-d^2 / w^2))  inside: a thin limb counts nearly as much as a thick one

so that a limb grows from its root, and shrinks back to it, at its own thickness (`limbs`). Surface
tension rounds the level by a Gaussian of width 4 s (1 - s) T, but leaves the limbs of the source
alone.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from morph_engine.flow.limbs import limbs_of, waiting

Field = NDArray[np.float32]

LIMB = 2.0
"""K: what the inside of a limb counts beside its depth [dx]."""

SKIN = 1.6
"""w: depth at which 63 % of that is reached [lattice steps]."""

PURE = 0.025
"""Share of the change, from either end, before which limbs and their order count less."""

FARTHEST = 6.0
"""Levels beyond this do not tell where a smooth body ends [dx]."""


class Blend:
    """Levels between two shapes.

    Args:
        source: Signed distance to the source on a cubic lattice [dx], shape [m, n, k].
        target: Signed distance to the target.
        step: Lattice step [dx].
        reach: L, beyond which distances outside are compressed [dx].
        tension: T, width of the rounding half-way [dx].
        raised: What the level is raised by between the ends, if that is known.
    """

    def __init__(
        self,
        source: Field,
        target: Field,
        step: float,
        *,
        reach: float,
        tension: float,
        raised: Field | None = None,
    ) -> None:
        self.step = step
        self.tension = tension
        self._reach = reach
        distances = source, target
        self._outer: list[Field] = [compressed(distance, reach) for distance in distances]
        self._inner: list[Field] = [inner(distance, SKIN * step) for distance in distances]
        if raised is None:
            raised = waiting(source, target, *self._ends(1.0), step)
        self._raised = raised
        self._limbs = limbs_of(source, step, tension) if tension else None

    def at(self, share: float) -> Field:
        """The level at a share of the change, before it is fitted to the scheduled volume."""
        s = np.float32(share)
        between = min(1.0, share * (1 - share) / PURE)
        level, last = self._ends(between)
        level *= 1 - s
        last *= s
        level += last
        np.multiply(self._raised, np.float32(between), out=last)
        level += last
        if self._limbs is None or not 0 < share < 1:
            return level
        width = 4 * share * (1 - share) * self.tension
        smooth = rounded(level, width / self.step)
        np.minimum(smooth, level, out=smooth, where=self._limbs)
        return smooth

    def _ends(self, limbs: float) -> tuple[Field, Field]:
        """f of both distances, with K over its full size."""
        weight = np.float32(limbs * LIMB)
        first, last = (weight * inner for inner in self._inner)
        first += self._outer[0]
        last += self._outer[1]
        return first, last

    def coarser(self, source: Field, target: Field) -> Blend:
        """The same between shapes given at every second point of the lattice."""
        raised = np.ascontiguousarray(self._raised[::2, ::2, ::2])
        return Blend(
            source, target, 2 * self.step, reach=self._reach, tension=self.tension, raised=raised
        )


def rounded(level: Field, width: float) -> Field:
    """Smooth a level by a Gaussian of some width [lattice steps]."""
    near = np.minimum(level, np.float32(FARTHEST))
    smooth: Field = scipy.ndimage.gaussian_filter(near, width, mode="nearest", truncate=3.0)
    return smooth


def inner(distance: Field, width: float) -> Field:
    """What K is multiplied by inside: 0 at the surface, towards -1 beyond some depth [dx]."""
    depth = np.minimum(distance, 0) / np.float32(width)
    return np.expm1(-np.square(depth))


def compressed(distance: Field, reach: float) -> Field:
    """A signed distance that grows like a logarithm outside, beyond some reach [dx]."""
    outside = np.maximum(distance, 0)
    return np.where(
        distance > 0, np.float32(reach) * np.log1p(outside / np.float32(reach)), distance
    )
