"""Where the shapes of a morph are put in the domain, and how it comes back from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field

from morph_engine.errors import MeshError
from morph_engine.geometry import rotation as rotations
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.sampling import (
    FIT_HALF_EXTENT,
    HALF_EXTENT,
    Fit,
    Similarity,
    fitting_similarity,
)
from morph_engine.geometry.upward import Up, turn_between
from morph_engine.sections import PlacementConfig, PoseConfig

LARGEST_FACTOR = 2.0
"""A shape is of usual size where `volume` would scale it by at most this factor, up or down."""

COMES_BACK = "; results come back in your own coordinates."

REASON = ", to be filled with enough particles" + COMES_BACK


@dataclass(frozen=True, eq=False)
class Solid:
    """What placing a shape needs to know of it, in its own coordinates.

    Attributes:
        volume: Enclosed volume.
        bounds: Lower and upper corner of the bounding box, shape [2, 3], float64.
        built_in: Whether it is a built-in shape, in grid units, and not a file of the user's.
        up: The axis that points upwards in it; None where nothing tells.
    """

    volume: float
    bounds: npt.NDArray[np.float64]
    built_in: bool = False
    up: Up | None = None

    @classmethod
    def of(cls, mesh: Mesh) -> Solid:
        """That of a mesh."""
        return cls(mesh.volume, mesh.bounds, mesh.built_in, mesh.up)

    def turned(self, turn: Similarity) -> Solid:
        """The same turned, its bounding box being that of its turned box."""
        return self if turn == Similarity() else replace(self, bounds=turn.box(self.bounds))


_COORDINATES_OF: dict[Literal["both", "source", "target"], tuple[int, int]] = {
    "both": (0, 1),
    "source": (0, 0),
    "target": (1, 1),
}
"""The shape whose coordinates results have at each of two shapes."""


class Placement(BaseModel, frozen=True):
    """Where the shapes of a morph are in the domain."""

    source: Similarity = Field(Similarity(), description="Source's coordinates to grid units.")
    via: tuple[Similarity, ...] = Field(
        (),
        description="Likewise of the shapes between source and target.",
        exclude_if=lambda via: not via,
    )
    target: Similarity = Field(Similarity(), description="Target's coordinates to grid units.")
    coordinates: Literal["both", "source", "target"] = Field(
        "both", description="Whose coordinates results have; built-in shapes have none."
    )
    coordinates_of: tuple[int, ...] = Field(
        (),
        description="Of a morph through several shapes: for each of them, the index of the one "
        "whose coordinates results have there.",
        exclude_if=lambda indices: not indices,
    )
    message: str = Field("", description="What `auto` has done, in words; empty for nothing.")
    up: Up = Field("y", description="The axis of the domain that points upwards.")
    turning: str = Field(
        "", description="Which shapes are turned to stand upright, in words; empty for none."
    )

    @property
    def messages(self) -> tuple[str, ...]:
        """Sentences on what was done to the shapes unasked."""
        return tuple(filter(None, (self.message, self.turning)))

    @property
    def stops(self) -> tuple[Similarity, ...]:
        """Coordinates of each shape to grid units, from the source to the target."""
        return (self.source, *self.via, self.target)

    def to_user(self, share: float, leg: int = 0) -> Similarity:
        """Grid units to the user's coordinates, at a share of the way of a leg.

        These are the source's at 0 and the target's at 1, or those of the shapes that the leg leads
        from and to. Between them the scale changes by equal factors and the place by equal steps.
        """
        own = self.coordinates_of or _COORDINATES_OF[self.coordinates]
        first, last = (self.stops[own[index]] for index in (leg, leg + 1))
        return first.inverse().blended(last.inverse(), share)

    def of_leg(self, leg: int) -> Placement:
        """Where the two shapes of a leg are."""
        return Placement(source=self.stops[leg], target=self.stops[leg + 1])


def place(
    source: Solid | None,
    target: Solid | None,
    *,
    via: Sequence[Solid | None] = (),
    fit: Fit,
    half_extent: float = HALF_EXTENT,
    poses: PlacementConfig | None = None,
) -> Placement:
    """Choose where the shapes of a morph are in the domain.

    What is upright in the source is upright in the domain; if nothing tells what that is, the
    target decides. Shapes that stand on another axis are turned, then those whose pose asks for it.
    Then comes the fit, and at last what poses ask for beyond it. `none` guesses no axis to turn.

    `volume` and `extent` scale and centre each shape alone, see `sampling.fit_to_domain`; `none`
    changes nothing. `auto` takes the first of these that leaves all shapes in the domain and of
    usual size:

    1. all as they are;
    2. one scale and one shift for all, so that they stay where they are to each other;
    3. one scale for all, each centred alone, so that their sizes stay as they are to each other;
    4. each alone: as it is, or else as by `volume`.

    Beside a built-in shape 2 and 3 are left out: it stays, and the other ones are fitted to it.

    Args:
        source: The source; None for a point cloud, which stays as it is.
        target: The target, likewise.
        via: Shapes between them, likewise.
        fit: As `sampling.fit`.
        half_extent: Half edge of the usable cube [grid units].
        poses: How source and target are turned, scaled and moved.

    Raises:
        MeshError: A shape leaves the domain by what its pose asks for.
    """
    given = [source, *via, target]
    solids = [solid for solid in given if solid]
    if not solids:
        return _placement([Similarity()] * len(given), list(range(len(given))))
    poses = poses or PlacementConfig()
    stances = [poses.source, *(PoseConfig() for _ in via), poses.target]
    ups = [_up_of(*each) for each in zip(given, stances, strict=True)]
    known: list[Up] = [up for up in (ups[0], ups[-1], *ups) if up]
    upright: Up = known[0] if known else "y"
    if fit == "none":  # shapes are taken as they are, but for what poses ask
        ups = [None if pose.up == "auto" else up for up, pose in zip(ups, stances, strict=True)]
    turns = [
        _turn(solid, pose, up, upright) for solid, pose, up in zip(given, stances, ups, strict=True)
    ]
    every = [(solid or solids[0]).turned(turn) for solid, turn in zip(given, turns, strict=True)]
    placed, message = [Similarity()] * len(given), ""
    if fit == "auto":
        placed, message = _auto(every, half_extent)
    elif fit != "none":
        placed = [_alone(solid, fit, FIT_HALF_EXTENT) for solid in every]
    stops = [
        _posed(similarity.after(turn), solid, pose, name, half_extent) if solid else Similarity()
        for similarity, turn, solid, pose, name in zip(
            placed, turns, given, stances, _names(len(given)), strict=True
        )
    ]
    own = [index for index, solid in enumerate(every) if not solid.built_in]
    if not own and any(pose != PoseConfig() for pose in stances):
        own = [0]  # what comes from no file stays as it is asked for
    found = _placement(stops, _nearest_before(own, len(given)), message)
    return found.model_copy(update={"up": upright, "turning": _turning(ups, upright)})


def _up_of(solid: Solid | None, pose: PoseConfig) -> Up | None:
    if solid is None:
        return None
    return solid.up if pose.up == "auto" else pose.up


def _turn(solid: Solid | None, pose: PoseConfig, up: Up | None, upright: Up) -> Similarity:
    """The turn of a shape about the centre of its bounding box."""
    rotation = rotations.product(rotations.from_euler(pose.rotate), turn_between(up, upright))
    if solid is None or rotation == rotations.IDENTITY:
        return Similarity()
    centre = solid.bounds.mean(axis=0)
    x, y, z = (centre - Similarity(rotation=rotation).apply(centre)).tolist()
    return Similarity(offset=(x, y, z), rotation=rotation)


def _posed(
    fitted: Similarity, solid: Solid, pose: PoseConfig, name: str, half_extent: float
) -> Similarity:
    """A shape's map to grid units, scaled and moved as its pose asks for.

    Raises:
        MeshError: It leaves the domain by that.
    """
    if pose.scale == 1 and not any(pose.move):
        return fitted
    centre = fitted.box(solid.bounds).mean(axis=0)
    x, y, z = ((1 - pose.scale) * centre + np.asarray(pose.move)).tolist()
    posed = Similarity(pose.scale, (x, y, z)).after(fitted)
    reach = float(np.abs(posed.box(solid.bounds)).max())
    if reach > half_extent:
        raise MeshError(
            f"Scaled and moved as asked, {name} reaches {reach:.4g} grid units from the centre, "
            f"and the domain ends at {half_extent:g}.",
            f"Lower `placement.{name.removeprefix('the ')}.scale`, or move it less.",
        )
    return posed


def _turning(ups: list[Up | None], upright: Up) -> str:
    """Which shapes stand on another axis than the domain, in words."""
    turned = [name for name, up in zip(_names(len(ups)), ups, strict=True) if up and up != upright]
    if not turned:
        return ""
    names = " and ".join(turned)
    are, them = ("are", "them") if len(turned) > 1 else ("is", "it")
    others = "other shapes" if len(ups) > 2 else "other shape"
    return (
        f"{names[0].upper()}{names[1:]} {are} given a quarter turn about x, since "
        f"{'y' if upright == 'z' else 'z'} points upwards in {them} and {upright} in the {others}"
        + COMES_BACK
    )


def _names(count: int) -> list[str]:
    """Of so many shapes, as they stand in a sentence."""
    return ["the source", *(f"shape {number}" for number in range(2, count)), "the target"]


def _nearest_before(own: list[int], count: int) -> list[int]:
    """For each of so many shapes, the last of the user's own up to it, or else the first."""
    if not own:
        return list(range(count))
    return [max((i for i in own if i <= index), default=own[0]) for index in range(count)]


def _placement(stops: list[Similarity], coordinates_of: list[int], message: str = "") -> Placement:
    if len(stops) > 2:
        return Placement(
            source=stops[0],
            via=tuple(stops[1:-1]),
            target=stops[-1],
            coordinates_of=tuple(coordinates_of),
            message=message,
        )
    (whose,) = (name for name, own in _COORDINATES_OF.items() if own == tuple(coordinates_of))
    return Placement(source=stops[0], target=stops[1], coordinates=whose, message=message)


def placed(mesh: Mesh, similarity: Similarity) -> Mesh:
    """A mesh in grid units; itself where it stays as it is."""
    return mesh if similarity == Similarity() else similarity.applied(mesh)


def _auto(solids: Sequence[Solid], half_extent: float) -> tuple[list[Similarity], str]:
    """The maps of all shapes to grid units, and what is done in words."""
    reach = FIT_HALF_EXTENT * min(1.0, half_extent / HALF_EXTENT)
    usual = [_alone(solid, "volume", reach) for solid in solids]
    unchanged = [Similarity()] * len(solids)

    def suits(solid: Solid, alone: Similarity, similarity: Similarity) -> bool:
        factor = alone.scale / similarity.scale
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
        text = f"{every} scaled by {_number(together[0].scale)} and moved alike"
        return together, text + REASON
    scale = min(usual[0].scale, *(_scale_to(solid.bounds, reach) for solid in solids[1:]))
    one_scale = [_centred(solid.bounds, scale) for solid in solids]
    if all_suit(one_scale):
        text = f"{every} scaled by {_number(scale)} and each is centred"
        return one_scale, text + REASON
    return _each_alone(usual, stays)


def _each_alone(usual: list[Similarity], stays: list[bool]) -> tuple[list[Similarity], str]:
    """Each shape as it is, if it may stay, or else of usual size; and that in words."""
    placed = [Similarity() if stay else alone for stay, alone in zip(stays, usual, strict=True)]
    moved = [
        f"{name} {'is scaled ' if not index else ''}by {_number(similarity.scale)}"
        for index, (name, similarity) in enumerate(
            (name, similarity)
            for name, similarity, stay in zip(_names(len(placed)), placed, stays, strict=True)
            if not stay
        )
    ]
    text = ", ".join(moved[:-1]) + (" and " if len(moved) > 1 else "") + moved[-1]
    end = " and centred" if len(moved) == 1 else ", and each is centred"
    return placed, text[0].upper() + text[1:] + end + REASON


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
