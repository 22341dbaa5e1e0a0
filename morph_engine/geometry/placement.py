"""Where the shapes of a morph are put in the domain, and how it comes back from there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field

from morph_engine.errors import MeshError
from morph_engine.geometry import rotation as rotations
from morph_engine.geometry.automatic_fit import (
    COMES_BACK,
    automatic_fit,
    fit_alone,
    reach_in,
    shape_names,
)
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.sampling import HALF_EXTENT, Fit, Similarity
from morph_engine.geometry.solid import Solid
from morph_engine.geometry.upward import Up, turn_between
from morph_engine.sections import PlacementConfig, PoseConfig

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
        """Grid units to the user's coordinates, at a share of a leg.

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
    changes nothing; for `auto` see `automatic_fit`.

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
        placed, message = automatic_fit(every, half_extent)
    elif fit != "none":
        placed = [fit_alone(solid, fit, reach_in(half_extent)) for solid in every]
    stops = [
        _posed(similarity.after(turn), solid, pose, name, half_extent) if solid else Similarity()
        for similarity, turn, solid, pose, name in zip(
            placed, turns, given, stances, shape_names(len(given)), strict=True
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
            f"Scaled and moved as requested, {name} reaches {reach:.4g} grid units from "
            f"the centre, beyond the domain, which ends at {half_extent:g}.",
            f"Lower `placement.{name.removeprefix('the ')}.scale`, or move it less.",
        )
    return posed


def _turning(ups: list[Up | None], upright: Up) -> str:
    """Which shapes stand on another axis than the domain, in words."""
    turned = [
        name for name, up in zip(shape_names(len(ups)), ups, strict=True) if up and up != upright
    ]
    if not turned:
        return ""
    names = " and ".join(turned)
    are, them = ("are", "them") if len(turned) > 1 else ("is", "it")
    others = "other shapes" if len(ups) > 2 else "other shape"
    return (
        f"{names[0].upper()}{names[1:]} {are} rotated by 90 degrees about x, since "
        f"{'y' if upright == 'z' else 'z'} points upwards in {them} and {upright} in the "
        f"{others}" + COMES_BACK
    )


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
