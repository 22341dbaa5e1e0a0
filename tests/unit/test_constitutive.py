"""Elastic laws against their energies (algorithm 2.2, 2.8, 4.5, 13.1)."""

import numpy as np
import pytest
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.mpm.constitutive import (
    FIXED_COROTATED,
    NEO_HOOKEAN,
    kirchhoff_stress,
    kirchhoff_stress_adjoint,
    rotation,
)

pytestmark = [
    pytest.mark.usefixtures("float64_device"),
    pytest.mark.parametrize("model", [NEO_HOOKEAN, FIXED_COROTATED], ids=["neo", "corotated"]),
]
LAMBDA, MU = 3.9, 5.8
Matrices = NDArray[np.float64]


@ti.kernel
def evaluate(
    a: ti.types.ndarray(),
    t_bar: ti.types.ndarray(),
    t: ti.types.ndarray(),
    a_bar: ti.types.ndarray(),
    model: ti.template(),
):
    """T(A) and the gradient of T(A) : T_bar."""
    for i in range(a.shape[0]):
        r = rotation(a[i])
        t[i] = kirchhoff_stress(a[i], r, LAMBDA, MU, model)
        a_bar[i] = kirchhoff_stress_adjoint(a[i], r, t_bar[i], LAMBDA, MU, model)


def laws(a: Matrices, z: Matrices, model: int) -> tuple[Matrices, Matrices]:
    """P(A) and dP(A)[Z] of many matrices, from T = P A^T and its adjoint at T_bar = Z A^-1."""
    device = backend.active()
    inverse = np.linalg.inv(a)
    t_bar = z @ inverse
    t, a_bar = device.matrices(len(a)), device.matrices(len(a))
    evaluate(device.upload(a), device.upload(t_bar), t, a_bar, model)
    p = t.to_numpy() @ inverse.transpose(0, 2, 1)
    return p, a_bar.to_numpy() - t_bar.transpose(0, 2, 1) @ p


def energy(a: Matrices, model: int) -> NDArray[np.float64]:
    """psi(A), by singular values and by definition."""
    j = np.linalg.det(a)
    if model == NEO_HOOKEAN:
        log = np.log(j)
        return MU / 2 * ((a**2).sum((1, 2)) - 3) - MU * log + LAMBDA / 2 * log**2
    sigma = np.linalg.svd(a, compute_uv=False)
    return MU * ((sigma - 1) ** 2).sum(1) + LAMBDA / 2 * (j - 1) ** 2


def samples() -> tuple[Matrices, Matrices]:
    """Strained, rotated matrices and directions."""
    rng = np.random.default_rng(0)
    q, _ = np.linalg.qr(rng.normal(size=(50, 3, 3)))
    q *= np.sign(np.linalg.det(q))[:, None, None]
    return q @ (np.eye(3) + 0.2 * rng.normal(size=(50, 3, 3))), rng.normal(size=(50, 3, 3))


def test_stress_is_the_slope_of_the_energy(model: int) -> None:
    """P:Z equals the central difference of psi along Z."""
    a, z = samples()
    p, _ = laws(a, z, model)
    step = 1e-5
    difference = (energy(a + step * z, model) - energy(a - step * z, model)) / (2 * step)
    np.testing.assert_allclose((p * z).sum((1, 2)), difference, rtol=1e-7, atol=1e-7)


def test_differential_is_the_slope_of_the_stress(model: int) -> None:
    """dP(A)[Z] equals the central difference of P along Z."""
    a, z = samples()
    _, dp = laws(a, z, model)
    step = 1e-6
    difference = (laws(a + step * z, z, model)[0] - laws(a - step * z, z, model)[0]) / (2 * step)
    np.testing.assert_allclose(dp, difference, rtol=1e-6, atol=1e-6)


def test_differential_is_symmetric(model: int) -> None:
    """Z1:dP[Z2] = Z2:dP[Z1]."""
    a, z = samples()
    w = np.roll(z, 1, axis=0)
    first, second = laws(a, z, model)[1], laws(a, w, model)[1]
    np.testing.assert_allclose((w * first).sum((1, 2)), (z * second).sum((1, 2)), rtol=1e-9)


def test_rotations_are_free_of_stress(model: int) -> None:
    """P(R) = 0."""
    q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(50, 3, 3)))
    q *= np.sign(np.linalg.det(q))[:, None, None]
    p, _ = laws(q, np.zeros_like(q), model)
    np.testing.assert_allclose(p, 0, atol=1e-13)
