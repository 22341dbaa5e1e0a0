"""How shapes of any size and place are fitted to the domain, changing as little as can be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from morph_engine.geometry.sampling import (
    FIT_HALF_EXTENT,
    HALF_EXTENT,
    Fit,
    Similarity,
    fitting_similarity,
)
from morph_engine.geometry.solid import Solid

LARGEST_FACTOR = 2.0
"""A shape is of usual size where `volume` would scale it by at most this factor, up or down."""

COMES_BACK = "; results come back in your own coordinates."

REASON = ", to be filled with enough particles" + COMES_BACK


def fit_alone(solid: Solid, fit: Fit, reach: float = FIT_HALF_EXTENT) -> Similarity:
    """The map of a shape to grid units by which it is scaled and centred alone.

    Args:
        solid: The shape.
        fit: `volume` or `extent`, see `sampling.fitting_similarity`.
        reach: Half edge of the cube that it may fill [grid units].
    """
    return fitting_similarity(solid.volume, solid.bounds, mode=fit, reach=reach)


def reach_in(half_extent: float) -> float:
    """Half edge of the cube that shapes may fill in a domain of this one [grid units]."""
    return FIT_HALF_EXTENT * min(1.0, half_extent / HALF_EXTENT)


def shape_names(count: int) -> list[str]:
    """Of so many shapes, as they stand in a sentence."""
    return ["the source", *(f"shape {number}" for number in range(2, count)), "the target"]


def automatic_fit(solids: Sequence[Solid], half_extent: float) -> tuple[list[Similarity], str]:
    """The maps of shapes to grid units that change as little as can be, and what is done in words.

    The first of these that leaves all shapes in the domain and of usual size:

    1. all as they are;
    2. one scale and one shift for all, so that they stay where they are to each other;
    3. one scale for all, each centred alone, so that their sizes stay as they are to each other;
    4. each alone: as it is, or else as by `volume`.

    Beside a built-in shape 2 and 3 are left out: it stays, and the other ones are fitted to it.

    Args:
        solids: The shapes, from the source to the target.
        half_extent: Half edge of the usable cube [grid units].
    """
    reach = reach_in(half_extent)
    usual = [fit_alone(solid, "volume", reach) for solid in solids]
    unchanged = [Similarity()] * len(solids)

    def suits(solid: Solid, size: Similarity, similarity: Similarity) -> bool:
        factor = size.scale / similarity.scale
        corners = similarity.apply(solid.bounds)
        return bool(
            1 / LARGEST_FACTOR <= factor <= LARGEST_FACTOR and np.abs(corners).max() <= half_extent
        )

    def all_suit(similarities: list[Similarity]) -> bool:
        return all(map(suits, solids, usual, similarities))

    if all_suit(unchanged):
        return unchanged, ""
    stays = [suits(*each, Similarity()) for each in zip(solids, usual, strict=True)]
    if any(solid.built_in for solid in solids):
        return _each_alone(usual, stays)
    every = "Both shapes are" if len(solids) == 2 else "All shapes are"
    bounds = np.stack([solid.bounds for solid in solids])
    union = np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])
    together = [_centred(union, min(usual[0].scale, _scale_to(union, reach)))] * len(solids)
    if all_suit(together):
        text = f"{every} scaled by {_number(together[0].scale)} and moved together"
        return together, text + REASON
    scale = min(usual[0].scale, *(_scale_to(solid.bounds, reach) for solid in solids[1:]))
    one_scale = [_centred(solid.bounds, scale) for solid in solids]
    if all_suit(one_scale):
        text = f"{every} scaled by {_number(scale)} and each is centred"
        return one_scale, text + REASON
    return _each_alone(usual, stays)


def _each_alone(usual: list[Similarity], stays: list[bool]) -> tuple[list[Similarity], str]:
    """Each shape as it is, if it may stay, or else of usual size; and that in words."""
    placed = [Similarity() if stay else size for stay, size in zip(stays, usual, strict=True)]
    moved = [
        f"{name} {'is scaled ' if not index else ''}by {_number(similarity.scale)}"
        for index, (name, similarity) in enumerate(
            (name, similarity)
            for name, similarity, stay in zip(shape_names(len(placed)), placed, stays, strict=True)
            if not stay
        )
    ]
    text = ", ".join(moved[:-1]) + (" and " if len(moved) > 1 else "") + moved[-1]
    end = " and centred" if len(moved) == 1 else ", and each is centred"
    return placed, text[0].upper() + text[1:] + end + REASON


def _scale_to(bounds: npt.NDArray[np.float64], reach: float) -> float:
    """The scale that makes a box span the cube of half edge `reach`."""
    return 2 * reach / float((bounds[1] - bounds[0]).max())


def _centred(bounds: npt.NDArray[np.float64], scale: float) -> Similarity:
    x, y, z = (-scale * bounds.sum(axis=0) / 2).tolist()
    return Similarity(scale, (x, y, z))


def _number(scale: float) -> str:
    """A scale as people read it: 2,350, 3.1, 0.0034."""
    return f"{scale:,.0f}" if scale >= 100 else f"{scale:.3g}"
