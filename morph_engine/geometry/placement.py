"""Where two shapes are put in the domain, and how their morph comes back from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.sampling import (
    FIT_HALF_EXTENT,
    HALF_EXTENT,
    Fit,
    Similarity,
    fitting_similarity,
)

LARGEST_FACTOR = 2.0
"""A shape is of usual size where `volume` would scale it by at most this factor, up or down."""

REASON = ", to be filled with enough particles; results come back in your own coordinates."

Pair = tuple[Similarity, Similarity]


@dataclass(frozen=True, eq=False)
class Solid:
    """What placing a shape needs to know of it, in its own coordinates.

    Attributes:
        volume: Enclosed volume.
        bounds: Lower and upper corner of the bounding box, shape [2, 3], float64.
        built_in: Whether it is a built-in shape, in grid units, and not a file of the user's.
    """

    volume: float
    bounds: npt.NDArray[np.float64]
    built_in: bool = False

    @classmethod
    def of(cls, mesh: Mesh) -> Solid:
        """That of a mesh."""
        return cls(mesh.volume, mesh.bounds, mesh.built_in)


class Placement(BaseModel, frozen=True):
    """Where two shapes are in the domain."""

    source: Similarity = Field(Similarity(), description="Source's coordinates to grid units.")
    target: Similarity = Field(Similarity(), description="Target's coordinates to grid units.")
    coordinates: Literal["both", "source", "target"] = Field(
        "both", description="Whose coordinates results have; built-in shapes have none."
    )
    message: str = Field("", description="What `auto` has done, in words; empty for nothing.")

    def to_user(self, share: float) -> Similarity:
        """Grid units to the user's coordinates, at a share of the way from source to target.

        These are the source's at 0 and the target's at 1. Between them the scale changes by equal
        factors and the place by equal steps.
        """
        first = self.target if self.coordinates == "target" else self.source
        last = self.source if self.coordinates == "source" else self.target
        return first.inverse().blended(last.inverse(), share)


def place(
    source: Solid | None, target: Solid | None, *, fit: Fit, half_extent: float = HALF_EXTENT
) -> Placement:
    """Choose where two shapes are in the domain.

    `volume` and `extent` scale and centre each shape alone, see `sampling.fit_to_domain`; `none`
    changes nothing. `auto` takes the first of these that leaves both shapes in the domain and of
    usual size:

    1. both as they are;
    2. one scale and one shift for both, so that they stay where they are to each other;
    3. one scale for both, each centred alone, so that their sizes stay as they are to each other;
    4. each alone: as it is, or else as by `volume`.

    Beside a built-in shape 2 and 3 are left out: it stays, and the other one is fitted to it.

    Args:
        source: The source; None for a point cloud, which stays as it is.
        target: The target, likewise.
        fit: As `sampling.fit`.
        half_extent: Half edge of the usable cube [grid units].
    """
    solids = [solid for solid in (source, target) if solid]
    if not solids:
        return Placement()
    first, last = source or solids[0], target or solids[0]
    placed, message = (Similarity(), Similarity()), ""
    if fit == "auto":
        placed, message = _auto(first, last, half_extent)
    elif fit != "none":
        placed = _alone(first, fit, FIT_HALF_EXTENT), _alone(last, fit, FIT_HALF_EXTENT)
    own = [role for role, solid in (("source", first), ("target", last)) if not solid.built_in]
    return Placement(
        source=placed[0] if source else Similarity(),
        target=placed[1] if target else Similarity(),
        coordinates=own[0] if len(own) == 1 else "both",
        message=message,
    )


def placed(mesh: Mesh, similarity: Similarity) -> Mesh:
    """A mesh in grid units; itself where it stays as it is."""
    return mesh if similarity == Similarity() else similarity.applied(mesh)


def _auto(source: Solid, target: Solid, half_extent: float) -> tuple[Pair, str]:
    """The maps of both shapes to grid units, and what is done in words."""
    solids = (source, target)
    reach = FIT_HALF_EXTENT * min(1.0, half_extent / HALF_EXTENT)
    usual = [_alone(solid, "volume", reach) for solid in solids]

    def suits(solid: Solid, alone: Similarity, similarity: Similarity) -> bool:
        factor = alone.scale / similarity.scale
        corners = similarity.apply(solid.bounds)
        return bool(
            1 / LARGEST_FACTOR <= factor <= LARGEST_FACTOR and np.abs(corners).max() <= half_extent
        )

    def both_suit(*pair: Similarity) -> bool:
        return all(map(suits, solids, usual, pair))

    if both_suit(Similarity(), Similarity()):
        return (Similarity(), Similarity()), ""
    stays = [suits(*each, Similarity()) for each in zip(solids, usual, strict=True)]
    if source.built_in or target.built_in:
        return _each_alone(usual, stays)
    every = np.stack([solid.bounds for solid in solids])
    union = np.stack([every[:, 0].min(axis=0), every[:, 1].max(axis=0)])
    together = _centred(union, min(usual[0].scale, _scale_to(union, reach)))
    if both_suit(together, together):
        text = f"Both shapes are scaled by {_number(together.scale)} and moved alike"
        return (together, together), text + REASON
    scale = min(usual[0].scale, _scale_to(target.bounds, reach))
    one_scale = _centred(source.bounds, scale), _centred(target.bounds, scale)
    if both_suit(*one_scale):
        text = f"Both shapes are scaled by {_number(scale)} and each is centred"
        return one_scale, text + REASON
    return _each_alone(usual, stays)


def _each_alone(usual: list[Similarity], stays: list[bool]) -> tuple[Pair, str]:
    """Each shape as it is, if it may stay, or else of usual size; and that in words."""
    first, last = (
        Similarity() if stay else alone for stay, alone in zip(stays, usual, strict=True)
    )
    if any(stays):
        name, moved = ("target", last) if stays[0] else ("source", first)
        text = f"The {name} is scaled by {_number(moved.scale)} and centred"
        return (first, last), text + REASON
    text = (
        f"The source is scaled by {_number(first.scale)} and the target by {_number(last.scale)}, "
        "and each is centred"
    )
    return (first, last), text + REASON


def _alone(solid: Solid, fit: Fit, reach: float) -> Similarity:
    return fitting_similarity(solid.volume, solid.bounds, mode=fit, reach=reach)


def _scale_to(bounds: npt.NDArray[np.float64], reach: float) -> float:
    """The scale that makes a box span the cube of half edge `reach`."""
    return 2 * reach / float((bounds[1] - bounds[0]).max())


def _centred(bounds: npt.NDArray[np.float64], scale: float) -> Similarity:
    x, y, z = (-scale * bounds.sum(axis=0) / 2).tolist()
    return Similarity(scale, (x, y, z))


def _number(scale: float) -> str:
    """A scale as people read it: 2,350, 3.1, 0.0034."""
    return f"{scale:,.0f}" if scale >= 100 else f"{scale:.3g}"
