"""Identities of the B-spline kernels and of the transfers (algorithm 13.1)."""

import numpy as np
import pytest
import taichi as ti

from morph_engine import backend
from morph_engine.mpm import b_spline
from morph_engine.mpm.constitutive import FIXED_COROTATED, NEO_HOOKEAN
from morph_engine.mpm.grid import Grid, base_and_offset
from morph_engine.mpm.simulation import Material, Simulation
from morph_engine.mpm.state import Particles

pytestmark = pytest.mark.usefixtures("float64_device")
GRIDS = [Grid(half_extent=4.0, width=4), Grid(half_extent=4.0, width=3)]
IDS = ["cubic", "quadratic"]


@ti.kernel
def moments(
    x: ti.types.ndarray(),
    value: ti.types.ndarray(),
    vector: ti.types.ndarray(),
    square: ti.types.ndarray(),
    slope: ti.types.ndarray(),
    slope_square: ti.types.ndarray(),
    g: ti.template(),
):
    """Sums over the stencil: w, w d, w d (x) d, grad w, grad w (x) d."""
    for p in range(x.shape[0]):
        base, u = base_and_offset(x[p], g)
        wx, wy, wz = (
            b_spline.weights(u.x, g.width),
            b_spline.weights(u.y, g.width),
            b_spline.weights(u.z, g.width),
        )
        gx, gy, gz = (
            b_spline.weight_derivatives(u.x, g.width),
            b_spline.weight_derivatives(u.y, g.width),
            b_spline.weight_derivatives(u.z, g.width),
        )
        total, first = 0.0, ti.Vector.zero(float, 3)
        second, gradient = ti.Matrix.zero(float, 3, 3), ti.Vector.zero(float, 3)
        gradient_first = ti.Matrix.zero(float, 3, 3)
        for i, j, k in ti.ndrange(g.width, g.width, g.width):
            node = g.origin + g.dx * (base + ti.Vector([i, j, k]))
            d = node - x[p]
            w = wx[i] * wy[j] * wz[k]
            dw = ti.Vector([gx[i] * wy[j] * wz[k], wx[i] * gy[j] * wz[k], wx[i] * wy[j] * gz[k]])
            total += w
            first += w * d
            second += w * d.outer_product(d)
            gradient += dw / g.dx
            gradient_first += (dw / g.dx).outer_product(d)
        value[p] = total
        vector[p] = first
        square[p] = second
        slope[p] = gradient
        slope_square[p] = gradient_first


@pytest.mark.parametrize("grid", GRIDS, ids=IDS)
def test_moments(grid: Grid) -> None:
    """Partition of unity, no first moment, and a second moment of I / c; their derivatives."""
    device = backend.active()
    n = 200
    x = np.random.default_rng(0).uniform(-3, 3, (n, 3))
    value, vector, slope = device.scalars(n), device.vectors(n), device.vectors(n)
    square, slope_square = device.matrices(n), device.matrices(n)
    moments(device.upload(x), value, vector, square, slope, slope_square, grid)
    identity = np.broadcast_to(np.eye(3), (n, 3, 3))
    np.testing.assert_allclose(value.to_numpy(), 1, atol=1e-14)
    np.testing.assert_allclose(vector.to_numpy(), 0, atol=1e-14)
    np.testing.assert_allclose(square.to_numpy(), identity / grid.affine, atol=1e-14)
    np.testing.assert_allclose(slope.to_numpy(), 0, atol=1e-14)
    np.testing.assert_allclose(slope_square.to_numpy(), identity, atol=1e-14)


def simulation(particles: Particles, grid: Grid, model: int, steps: int) -> Simulation:
    """Undisturbed particles in a small domain."""
    result = Simulation(
        np.full(len(particles.x), 1 / 27),
        grid=grid,
        material=Material(model, 38888.89, 58333.3, 75 / 27, 0.5),
        dt=1 / 120,
        transitions=steps,
        domain=4.0,
    )
    result.smoothing = 0.9
    result.layers[0].upload(particles)
    return result


@pytest.mark.parametrize("grid", GRIDS, ids=IDS)
def test_transfer_conserves_mass_and_momentum(grid: Grid) -> None:
    """The grid holds all mass, and all momentum but the drag's share."""
    rng = np.random.default_rng(1)
    particles = Particles.at_rest(rng.uniform(-2, 2, (300, 3)))
    particles.v[:] = rng.normal(size=(300, 3))
    s = simulation(particles, grid, NEO_HOOKEAN, 1)
    s.forward()
    grid = s.transitions[0].nodes.to_numpy()
    mass = grid[:, 3]
    assert mass.sum() == pytest.approx(300 * 75 / 27, rel=1e-13)
    momentum = (mass[:, None] * grid[:, :3]).sum(axis=0)
    expected = (1 - 0.5 / 120) * 75 / 27 * particles.v.sum(axis=0)
    np.testing.assert_allclose(momentum, expected, rtol=1e-11)


@pytest.mark.parametrize("model", [NEO_HOOKEAN, FIXED_COROTATED], ids=["neo", "corotated"])
@pytest.mark.parametrize("grid", GRIDS, ids=IDS)
def test_uniform_motion(grid: Grid, model: int) -> None:
    """A body in uniform motion slows by the drag alone and does not deform."""
    rng = np.random.default_rng(2)
    particles = Particles.at_rest(rng.uniform(-1, 1, (200, 3)))
    velocity = np.array([1.0, -2.0, 0.5])
    particles.v[:] = velocity
    s = simulation(particles, grid, model, 5)
    assert s.forward() == 0
    end = s.last.download()
    np.testing.assert_allclose(
        end.v, np.tile(velocity * (1 - 0.5 / 120) ** 5, (200, 1)), rtol=1e-12
    )
    np.testing.assert_allclose(end.C, 0, atol=1e-11)
    np.testing.assert_allclose(end.F, np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)


def test_particles_anywhere_cannot_crash() -> None:
    """Particles far outside, infinite or undefined are reported, not written out of bounds."""
    positions = np.random.default_rng(3).uniform(-1, 1, (64, 3))
    positions[0] = 1e30
    positions[1] = np.inf
    positions[2] = np.nan
    positions[3] = [-4.0, 0, 4.0]
    s = simulation(Particles.at_rest(positions), Grid(half_extent=4.0), NEO_HOOKEAN, 2)
    assert s.forward() != 0
    s.bar.clear()
    s.backward()
