"""The hand-written adjoint against Taichi's automatic differentiation, in float64."""

from typing import Any

import numpy as np
import taichi as ti

from morph_engine import backend
from morph_engine.mpm.constitutive import NEO_HOOKEAN
from morph_engine.mpm.grid import Grid
from morph_engine.mpm.simulation import Material, Simulation
from morph_engine.mpm.state import Particles

COUNT, STEPS, NODES, HALF = 40, 2, 9, 4.0
LAMBDA, MU, MASS, DRAG, DT, SMOOTHING = 38888.89, 58333.3, 2.7, 0.5, 1 / 120, 0.9

Array = ti.types.ndarray()


@ti.func
def spline(d):
    """Cubic B-spline of a distance in cells, by its definition."""
    a = ti.abs(d)
    return ti.select(a < 1, 0.5 * a**3 - a**2 + 2 / 3, (2 - a) ** 3 / 6)


@ti.kernel
def stress_momentum(F: Array, U: Array, C: Array, volume: Array, B: Array):
    """B of algorithm 2.3, neo-Hookean."""
    for p in range(COUNT):
        A = F[p] + U[p]
        inverse = A.inverse().transpose()
        P = MU * (A - inverse) + LAMBDA * ti.log(A.determinant()) * inverse
        B[p] = -3 * DT * volume[p] * (P @ A.transpose()) + MASS * C[p]


@ti.kernel
def to_grid(x: Array, v: Array, B: Array, momentum: Array, mass: Array):
    """Momentum and mass of the nodes."""
    for p, i, j, k in ti.ndrange(COUNT, 4, 4, 4):
        base = ti.cast(ti.floor(x[p] + HALF), ti.i32) - 1
        node = base + ti.Vector([i, j, k])
        d = ti.cast(node, ti.f64) - HALF - x[p]
        w = spline(d.x) * spline(d.y) * spline(d.z)
        momentum[node] += w * ((1 - DT * DRAG) * MASS * v[p] + B[p] @ d)
        mass[node] += w * MASS


@ti.kernel
def divide(momentum: Array, mass: Array, velocity: Array):
    """Velocity of the nodes."""
    for node in ti.grouped(ti.ndrange(NODES, NODES, NODES)):
        if mass[node] > 1e-12:
            velocity[node] = momentum[node] / mass[node]


@ti.kernel
def to_particles(x: Array, velocity: Array, v_next: Array, C_next: Array):
    """Velocity and affine velocity of the particles."""
    for p, i, j, k in ti.ndrange(COUNT, 4, 4, 4):
        base = ti.cast(ti.floor(x[p] + HALF), ti.i32) - 1
        node = base + ti.Vector([i, j, k])
        d = ti.cast(node, ti.f64) - HALF - x[p]
        w = spline(d.x) * spline(d.y) * spline(d.z)
        v_next[p] += w * velocity[node]
        C_next[p] += 3 * w * velocity[node].outer_product(d)


@ti.kernel
def update(
    x: Array, F: Array, U: Array, v_next: Array, C_next: Array, x_next: Array, F_next: Array
):
    """Positions and deformation gradients."""
    for p in range(COUNT):
        A = F[p] + U[p]
        x_next[p] = x[p] + DT * v_next[p]
        F_next[p] = (1 - SMOOTHING) * (A + DT * C_next[p] @ A) + SMOOTHING * F[p]


@ti.kernel
def functional(x: Array, weight: Array, loss: Array):
    """A linear functional of the positions."""
    for p in range(COUNT):
        loss[None] += weight[p].dot(x[p])


def test_control_gradients_equal_autodiff() -> None:
    """Control and state gradients of two steps agree to 1e-10 of their largest entry."""
    backend.start("cpu", precision="float64")
    rng = np.random.default_rng(5)
    state = Particles(
        x=rng.uniform(-1.2, 1.2, (COUNT, 3)),
        v=rng.normal(size=(COUNT, 3)),
        C=rng.normal(size=(COUNT, 3, 3)),
        F=np.eye(3) + 0.1 * rng.normal(size=(COUNT, 3, 3)),
    )
    control = 0.02 * rng.normal(size=(STEPS, COUNT, 3, 3))
    volume = rng.uniform(0.03, 0.06, COUNT)
    weight = rng.normal(size=(COUNT, 3))

    ours = Simulation(
        volume,
        grid=Grid(half_extent=HALF),
        material=Material(NEO_HOOKEAN, LAMBDA, MU, MASS, DRAG),
        dt=DT,
        transitions=STEPS,
        domain=3.5,
    )
    ours.smoothing = SMOOTHING
    ours.layers[0].upload(state)
    for transition, value in zip(ours.transitions, control, strict=True):
        transition.U.from_numpy(value)
    assert ours.forward() == 0
    ours.bar.clear()
    ours.bar.x.from_numpy(weight)
    ours.backward()

    expected = autodiff(state, control, volume, weight)
    gradients = ours.bar.download()
    values = {"x": gradients.x, "v": gradients.v, "C": gradients.C, "F": gradients.F}
    for k, transition in enumerate(ours.transitions):
        values[f"U{k}"] = transition.U_bar.to_numpy()
    for name, value in values.items():
        error = np.abs(value - expected[name]).max() / np.abs(expected[name]).max()
        assert error < 1e-10, name


def autodiff(
    state: Particles, control: np.ndarray, volume: np.ndarray, weight: np.ndarray
) -> dict[str, np.ndarray]:
    """Gradients of sum_p weight_p . x_p after all steps, by Taichi's tape."""
    cube = (NODES, NODES, NODES)

    def vectors(values: Any) -> Any:
        array = ti.ndarray(ti.types.vector(3, ti.f64), values.shape[:-1], needs_grad=True)
        array.from_numpy(np.ascontiguousarray(values))
        return array

    def matrices(values: Any) -> Any:
        array = ti.ndarray(ti.types.matrix(3, 3, ti.f64), values.shape[0], needs_grad=True)
        array.from_numpy(np.ascontiguousarray(values))
        return array

    zero3, zero33 = np.zeros((COUNT, 3)), np.zeros((COUNT, 3, 3))
    x, v = [vectors(state.x)], [vectors(state.v)]
    C, F = [matrices(state.C)], [matrices(state.F)]
    U = [matrices(u) for u in control]
    B = [matrices(zero33) for _ in range(STEPS)]
    momentum = [vectors(np.zeros((*cube, 3))) for _ in range(STEPS)]
    velocity = [vectors(np.zeros((*cube, 3))) for _ in range(STEPS)]
    mass = [ti.ndarray(ti.f64, cube, needs_grad=True) for _ in range(STEPS)]
    rest, pull = ti.ndarray(ti.f64, COUNT), ti.Vector.ndarray(3, ti.f64, COUNT)
    rest.from_numpy(volume)
    pull.from_numpy(weight)
    loss = ti.ndarray(ti.f64, (), needs_grad=True)
    for _ in range(STEPS):
        x.append(vectors(zero3))
        v.append(vectors(zero3))
        C.append(matrices(zero33))
        F.append(matrices(zero33))
    with ti.ad.Tape(loss=loss):
        for k in range(STEPS):
            stress_momentum(F[k], U[k], C[k], rest, B[k])
            to_grid(x[k], v[k], B[k], momentum[k], mass[k])
            divide(momentum[k], mass[k], velocity[k])
            to_particles(x[k], velocity[k], v[k + 1], C[k + 1])
            update(x[k], F[k], U[k], v[k + 1], C[k + 1], x[k + 1], F[k + 1])
        functional(x[-1], pull, loss)
    result = {"x": x[0], "v": v[0], "C": C[0], "F": F[0]}
    result |= {f"U{k}": u for k, u in enumerate(U)}
    return {name: array.grad.to_numpy() for name, array in result.items()}
