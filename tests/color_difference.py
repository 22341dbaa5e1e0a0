"""How different colours look."""

from __future__ import annotations

import numpy as np

from morph_engine import srgb


def lab(rgb):
    """CIE L*a*b* under D65 of sRGB, 0 to 255."""
    light = srgb.linear(np.asarray(rgb) / 255)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = light @ np.transpose(to_xyz) / (0.9505, 1.0, 1.089)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def differences(one, other):
    """CIE 1976 colour differences of sRGB colours, 0 to 255."""
    return np.linalg.norm(lab(one) - lab(other), axis=-1)
