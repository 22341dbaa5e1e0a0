"""Where the eye is during a film: still, around the shape, or through keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import PchipInterpolator

from morph_engine.errors import ConfigError

Move = Literal["still", "turn", "orbit"]

AZIMUTH = 25.0
ELEVATION = 15.0
"""Where the eye is when nobody says otherwise [degrees]."""

SWING = 20.0
"""How far an orbit rises and sinks [degrees]."""


@dataclass(frozen=True)
class View:
    """A place of the eye, which looks at the middle.

    Attributes:
        azimuth: Turn about the upward axis [degrees].
        elevation: Height above the horizon [degrees].
        zoom: How many times larger things are than where all is in the picture.
    """

    azimuth: float = AZIMUTH
    elevation: float = ELEVATION
    zoom: float = 1.0


@dataclass(frozen=True)
class CameraKey:
    """Where the eye is at a share of the film, from 0 to 1.

    Raises:
        ConfigError: A number is out of range.
    """

    share: float
    view: View

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise ConfigError(
                f"A camera key is at the time {self.share:g}.", "Times go from 0 to 1."
            )
        if not np.isfinite(self.view.azimuth):
            raise ConfigError(
                f"A camera key has the azimuth {self.view.azimuth:g}.",
                "Give a finite number of degrees.",
            )
        if not (abs(self.view.elevation) <= 90 and 0.1 <= self.view.zoom <= 100):
            raise ConfigError(
                f"A camera key has the elevation {self.view.elevation:g} and the zoom "
                f"{self.view.zoom:g}.",
                "Elevations go from -90 to 90 degrees, and zooms from 0.1 to 100.",
            )


@dataclass(frozen=True)
class CameraPath:
    """The path of the eye.

    Attributes:
        move: ``still``; ``turn``, once around at one height; ``orbit``, once around, and up and
            down on the way.
        keys: Places to go through in place of that, smoothly and never beyond them.

    Raises:
        ConfigError: Two keys are at the same time.
    """

    move: Move = "still"
    keys: tuple[CameraKey, ...] = ()

    def __post_init__(self) -> None:
        shares = [key.share for key in self.keys]
        if len(set(shares)) < len(shares):
            raise ConfigError("Two camera keys have the same time.", "Omit one of them.")

    def at(self, share: float) -> View:
        """Where the eye is after a share of the film."""
        if self.keys:
            return _between(sorted(self.keys, key=lambda key: key.share), share)
        if self.move == "turn":
            return View(azimuth=AZIMUTH - 360 * share)
        if self.move == "orbit":
            rise = SWING * float(np.sin(2 * np.pi * share))
            return View(azimuth=AZIMUTH - 360 * share, elevation=ELEVATION + rise)
        return View()


def _between(keys: Sequence[CameraKey], share: float) -> View:
    if len(keys) == 1:
        return keys[0].view
    shares = [key.share for key in keys]
    places = [(key.view.azimuth, key.view.elevation, np.log(key.view.zoom)) for key in keys]
    share = float(np.clip(share, shares[0], shares[-1]))
    azimuth, elevation, zoom = PchipInterpolator(shares, places)(share).tolist()
    return View(azimuth, elevation, float(np.exp(zoom)))
