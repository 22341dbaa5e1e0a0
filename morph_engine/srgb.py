"""Colours: sRGB as files and screens have them, and linear light, in which colours are mixed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Light = npt.NDArray[np.float64]
"""Linear RGB, shape [..., 3], float64, 0 to 1."""

Bytes = npt.NDArray[np.uint8]
"""sRGB, shape [..., 3], uint8."""

CLAY = (0.79, 0.76, 0.70)
"""Colour of what has no other, sRGB, 0 to 1."""


def linear(srgb: npt.ArrayLike) -> Light:
    """Linear light of sRGB values, 0 to 1 both (IEC 61966-2-1)."""
    values = np.asarray(srgb, np.float64)
    light: Light = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return light


def encoded(light: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """sRGB values of linear light, 0 to 1 both; what is beyond is clipped."""
    values = np.clip(np.asarray(light, np.float64), 0, 1)
    srgb: npt.NDArray[np.float64] = np.where(
        values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055
    )
    return srgb


_LIGHT_OF_BYTES = linear(np.arange(256) / 255)


def from_bytes(colors: Bytes) -> Light:
    """Linear light of sRGB bytes."""
    light: Light = _LIGHT_OF_BYTES[colors]
    return light


def to_bytes(light: npt.ArrayLike) -> Bytes:
    """sRGB bytes of linear light."""
    colors: Bytes = np.rint(255 * encoded(light)).astype(np.uint8)
    return colors
