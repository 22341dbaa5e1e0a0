"""Metrics of the deformation gradients F."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from morph_engine.geometry.point_cloud import Points

AT_ONCE = 1 << 14
"""Particles whose gradients stay in the cache while they are worked on."""


def determinants(deformation: npt.ArrayLike) -> Points:
    """det F of each particle [ratio], shape [n], float64, from F [-], shape [n, 3, 3].

    Raises:
        ValueError: The shape is not [n, 3, 3] with n > 0.
    """
    gradients = np.asarray(deformation)
    if gradients.ndim != 3 or gradients.shape[1:] != (3, 3) or not len(gradients):
        raise ValueError(f"F has shape {list(gradients.shape)}, expected [n, 3, 3] with n > 0")
    # the rows' triple product: exact on the identity, and quiet where LAPACK warns of NaN
    det: Points = np.empty(len(gradients))
    with np.errstate(invalid="ignore", over="ignore"):
        for begin in range(0, len(gradients), AT_ONCE):
            part = slice(begin, begin + AT_ONCE)
            xx, xy, xz, yx, yy, yz, zx, zy, zz = np.asarray(
                gradients[part].reshape(-1, 9).T, np.float64, order="C"
            )
            det[part] = xx * (yy * zz - yz * zy) + xy * (yz * zx - yx * zz)
            det[part] += xz * (yx * zy - yy * zx)
    return det


def deformation_metrics(deformation: npt.ArrayLike) -> dict[str, float]:
    """Range and mean of det F over particles with deformation gradients F [-], shape [n, 3, 3].

    Returns:
        ``det_f_min``, ``det_f_max`` and ``det_f_mean``. A non-finite determinant counts as the
        worst value of each, -inf, inf and inf.

    Raises:
        ValueError: The shape is not [n, 3, 3] with n > 0.
    """
    return determinant_metrics(determinants(deformation))


def determinant_metrics(det: Points) -> dict[str, float]:
    """What `deformation_metrics` returns, of det F of each particle [ratio], shape [n]."""
    known = np.isfinite(det)
    return {
        "det_f_min": float(np.where(known, det, -np.inf).min()),
        "det_f_max": float(np.where(known, det, np.inf).max()),
        "det_f_mean": float(np.where(known, det, np.inf).mean()),
    }
