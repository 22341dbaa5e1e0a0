"""Colours of field values."""

from __future__ import annotations

import cmap
import numpy as np
import numpy.typing as npt

SEQUENTIAL = "viridis"
DIVERGING = "coolwarm"
HEIGHT = "turbo"
_IN_CATALOG = {
    SEQUENTIAL: "bids:viridis",
    DIVERGING: "matplotlib:coolwarm",
    HEIGHT: "google:turbo",
}
"""Their full names in the catalogue of cmap."""

UNKNOWN = 0.6
"""Grey of a value that is not finite."""


def limits(values: npt.ArrayLike, *, diverging: bool = False) -> tuple[float, float]:
    """The range that shows most of some values of any shape: their 1 and 99 % quantiles.

    A diverging range is symmetric about 1. Low < high; 0 and 1 where no value is finite.
    """
    array = np.asarray(values, np.float64)
    finite = array[np.isfinite(array)]
    if not finite.size:
        return 0.0, 1.0
    low, high = (float(value) for value in np.quantile(finite, [0.01, 0.99]))
    if diverging:
        reach = max(abs(low - 1), abs(high - 1))
        low, high = 1 - reach, 1 + reach
    return (low, high) if low < high else (low, low + 1)


def colors(
    values: npt.ArrayLike, low: float, high: float, *, palette: str = SEQUENTIAL
) -> npt.NDArray[np.float64]:
    """RGB of values, shape [n, 3], float64, 0 to 1, by a colour map of cmap from low to high.

    Grey where a value is not finite.
    """
    array = np.asarray(values, np.float64)
    chosen = cmap.Colormap(_IN_CATALOG.get(palette, palette))
    share = np.clip((array - low) / (high - low), 0, 1)
    rgb = np.asarray(chosen(np.nan_to_num(share)))[:, :3]
    rgb[~np.isfinite(array)] = UNKNOWN
    return rgb
