"""Methods that move points directly: losses, regularisers, optimiser, runs (algorithm 8.2-8.6)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from morph_engine import Trajectory, backend, methods, morph, presets
from morph_engine.config import MorphConfig
from morph_engine.cost import estimate
from morph_engine.errors import ConfigError, SimulationError
from morph_engine.losses.density_aware_chamfer import DensityAwareChamfer
from morph_engine.losses.k_nearest_neighbors import k_nearest_neighbors
from morph_engine.losses.matches import Matches
from morph_engine.losses.pair_loss import PairLoss
from morph_engine.losses.regularizers import Regularizers
from morph_engine.losses.weighted_chamfer import WeightedChamfer, density_weights
from morph_engine.methods import Method, Problem
from morph_engine.optimization.amsgrad import AMSGrad
from morph_engine.optimization.control_lattice import ControlLattice
from morph_engine.presets import configure
from morph_engine.sections import RegularizerConfig

POINT_METHODS = ("dco", "dcd", "density_aware", "shared_basis")
REGULARISED = {
    "regularizers.repulsion": 0.05,
    "regularizers.smoothness": 0.01,
    "regularizers.volume": 0.1,
}
Points = NDArray[np.float64]


def clouds(n: int = 300, m: int = 250) -> tuple[Points, Points]:
    """Two overlapping random clouds."""
    rng = np.random.default_rng(4)
    return rng.uniform(-2, 2, (n, 3)), rng.uniform(-1, 2.5, (m, 3))


def distances(x: Points, target: Points) -> tuple[Points, Points, Points, Points]:
    """All nearest neighbours by brute force: d_fwd, match, d_rev, match."""
    all_pairs = np.linalg.norm(x[:, None] - target, axis=2)
    return (
        all_pairs.min(axis=1), all_pairs.argmin(axis=1),
        all_pairs.min(axis=0), all_pairs.argmin(axis=0),
    )  # fmt: skip


def pair_loss(name: str, matches: Matches) -> PairLoss:
    """One of the losses over matched pairs, with weights that differ from point to point."""
    if name == "density_aware":
        return DensityAwareChamfer(matches, alpha=1.7)
    loss = WeightedChamfer(matches)
    rng = np.random.default_rng(9)
    if name == "weighted":
        loss.weigh(rng.uniform(0.5, 2, 300), rng.uniform(0.5, 2, 250))
    return loss


@pytest.mark.usefixtures("float64_device")
@pytest.mark.parametrize("name", ["plain", "weighted", "density_aware"])
def test_pair_gradients_match_differences(name: str) -> None:
    """Assignments and counts do not change over a tiny step, so differences see the gradient."""
    x, target = clouds()
    device = backend.active()
    at = device.upload(x)
    matches = Matches(device.upload(target), at)
    loss = pair_loss(name, matches)
    gradient = device.vectors(300)
    matches.update(at)
    loss.gradient(at, gradient)
    direction = np.random.default_rng(6).normal(size=x.shape)
    step, values = 1e-7, []
    for sign in (1, -1):
        matches.update(device.upload(x + sign * step * direction))
        values.append(loss.value())
    difference = (values[0] - values[1]) / (2 * step)
    assert np.sum(gradient.to_numpy() * direction) == pytest.approx(difference, rel=1e-6)


@pytest.mark.usefixtures("float64_device")
@pytest.mark.parametrize(
    "weights",
    [{"repulsion": 0.05}, {"smoothness": 0.3}, {"volume": 2.0}, {"repulsion": 1, "volume": 0.1}],
)
def test_regulariser_gradients_match_differences(weights: dict[str, float]) -> None:
    """Lists and threshold are frozen, as in the formula, so both ends of each pair are seen."""
    x, _ = clouds()
    x[:40] = x[40:80] + np.random.default_rng(3).normal(size=(40, 3)) * 0.02  # pairs that repel
    device = backend.active()
    source = np.random.default_rng(1).uniform(-1, 1, (300, 3))
    regularizers = Regularizers(source, RegularizerConfig(**weights))
    regularizers.rebuild(device.upload(x))
    gradient = device.vectors(300)
    regularizers.add_gradient(device.upload(x), gradient)
    direction = np.random.default_rng(6).normal(size=x.shape)
    step = 1e-7
    values = [regularizers.value(device.upload(x + s * step * direction)) for s in (1, -1)]
    difference = (values[0] - values[1]) / (2 * step)
    assert np.sum(gradient.to_numpy() * direction) == pytest.approx(difference, rel=1e-5)


@pytest.mark.usefixtures("float64_device")
def test_regularisers_are_those_of_the_formulas() -> None:
    """Each term by brute force (algorithm 8.4), and without weight there is no term."""
    x, _ = clouds()
    at = backend.active().upload(x)
    gaps = np.linalg.norm(x[:, None] - x, axis=2) + np.diag(np.full(300, np.inf))
    order = np.argsort(gaps, axis=1)
    near = np.take_along_axis(gaps, order[:, :8], axis=1)
    close = near < 0.5 * near.mean()
    terms = {
        "repulsion": np.sum(close / near**2) / (8 * 300),
        "smoothness": np.mean(np.sum((x - x[order[:, :12]].mean(axis=1)) ** 2, axis=1)),
        "volume": (np.ptp(x, axis=0).prod() / np.ptp(x[:200], axis=0).prod() - 1) ** 2,
    }
    for name, expected in terms.items():
        source = np.concatenate((x[:200], x[:100]))
        regularizers = Regularizers(source, RegularizerConfig(**{name: 1.0}))
        regularizers.rebuild(at)
        assert regularizers.value(at) == pytest.approx(expected, rel=1e-12)
    assert Regularizers(x, RegularizerConfig()).value(at) == 0


@pytest.mark.usefixtures("float64_device")
def test_density_aware_value_is_that_of_wu() -> None:
    """1 - exp(-alpha d) / n on both sides, with n the users of the match over an even share."""
    x, target = clouds()
    device = backend.active()
    at = device.upload(x)
    matches = Matches(device.upload(target), at)
    matches.update(at)
    d_fwd, to_target, d_rev, to_particle = distances(x, target)
    users_of_target = np.bincount(to_target, minlength=250)[to_target]
    users_of_particle = np.bincount(to_particle, minlength=300)[to_particle]
    expected = 0.5 * (
        np.mean(1 - 300 / 250 * np.exp(-1.7 * d_fwd) / users_of_target)
        + np.mean(1 - np.exp(-1.7 * d_rev) / users_of_particle)
    )
    assert DensityAwareChamfer(matches, 1.7).value() == pytest.approx(expected, rel=1e-12)


@pytest.mark.usefixtures("float64_device")
def test_density_aware_loss_sees_a_crowd_that_chamfer_does_not() -> None:
    """All particles on few targets: the forward Chamfer term is 0, this one is near its worst."""
    _, target = clouds()
    device = backend.active()
    losses = []
    for x in (target, np.repeat(target[:5], 50, axis=0)):
        at = device.upload(x)
        matches = Matches(device.upload(target), at)
        matches.update(at)
        assert matches.distances()[0].max() == 0
        losses.append(DensityAwareChamfer(matches, 1.0).value())
    assert losses[0] == pytest.approx(0, abs=1e-15)
    assert losses[1] > 0.5 * (1 - 1 / 50)


@pytest.mark.usefixtures("float64_device")
def test_basis_gradient_matches_differences() -> None:
    """The chain rule through the lattice gives the gradient by the control points."""
    x, target = clouds()
    device = backend.active()
    lattice = ControlLattice(x, 4, np.float64)
    rng = np.random.default_rng(5)
    control = rng.normal(size=(lattice.count, 3)) * 0.2
    matches = Matches(device.upload(target), device.upload(x))
    loss = WeightedChamfer(matches)

    def at(u: Points) -> float:
        matches.update(device.upload(x + lattice.displacements(u)))
        return loss.value()

    at(control)
    gradient = device.vectors(300)
    loss.gradient(device.upload(x + lattice.displacements(control)), gradient)
    slope = np.sum(
        lattice.gradient(gradient.to_numpy()) * (direction := rng.normal(size=(lattice.count, 3)))
    )
    step = 1e-7
    difference = (at(control + step * direction) - at(control - step * direction)) / (2 * step)
    assert slope == pytest.approx(difference, rel=1e-6)


def test_lattice_reproduces_translations_and_spans_the_box() -> None:
    """Weights sum to 1 at every point, corners included; 64 control points move each."""
    x, _ = clouds()
    x = (x - x.min(axis=0)) / np.ptp(x, axis=0)
    x[:2] = [0] * 3, [1] * 3
    lattice = ControlLattice(x * [1, 0.5, 0.3], 6, np.float64)
    assert lattice.count == (6 + 3) * (3 + 3) * (2 + 3)
    everywhere = lattice.displacements(np.tile([1.0, -2.0, 0.5], (lattice.count, 1)))
    np.testing.assert_allclose(everywhere, np.tile([1.0, -2.0, 0.5], (300, 1)), rtol=1e-14)
    one = lattice.displacements(np.eye(lattice.count)[:, :3])
    assert (one >= 0).all()


@pytest.mark.usefixtures("float64_device")
def test_amsgrad_is_the_published_update() -> None:
    """Ten lines of the formula of algorithm 8.2, with gradients that shrink so that u holds."""
    rng = np.random.default_rng(2)
    device = backend.active()
    values = rng.normal(size=(20, 3))
    on_device, gradient = device.upload(values), device.vectors(20)
    optimizer = AMSGrad(20, learning_rate=0.1, beta1=0.9, beta2=0.99, epsilon=1e-3)
    m = a = u = np.zeros((20, 3))
    for t in range(1, 41):
        g = rng.normal(size=(20, 3)) / t**2
        m = 0.9 * m + 0.1 * g
        a = 0.99 * a + 0.01 * g**2
        u = np.maximum(u, a)
        values = values - 0.1 / (1 - 0.9**t) * m / (np.sqrt(u) / np.sqrt(1 - 0.99**t) + 1e-3)
        gradient.from_numpy(g)
        optimizer.step(on_device, gradient)
    assert (u > a).all()
    np.testing.assert_allclose(on_device.to_numpy(), values, rtol=1e-12)


@pytest.mark.usefixtures("float32_device")
def test_far_points_approach_exponentially() -> None:
    """The residual falls as exp(-t lr / (N eps)) where eps is far above the gradient (13.1).

    Momentum delays the descent by 9 steps of rate 1/1000, and |g| / eps is 1/200: 2 % together.
    """
    source = np.random.default_rng(1).uniform(-0.1, 0.1, (1000, 3)).astype(np.float32)
    target = np.array([[5.0, 0, 0]], np.float32)
    config = configure(
        "published", {"method": "dco", "descent.learning_rate": 1.0, "descent.epsilon": 1.0}
    )
    method = methods.find("dco")(Problem(source, target, config))
    start = np.linalg.norm(source - target, axis=1)
    residual = [np.median(method.advance(frame).d_fwd / start) for frame in range(20)]
    expected = np.exp(-30e-3 * np.arange(1, 21))
    np.testing.assert_allclose(residual, expected, rtol=0.02)


@pytest.mark.parametrize(("weighting", "dense_over_sparse"), [("published", 4), ("inverse", 1 / 4)])
def test_density_weights_have_either_sign(weighting: str, dense_over_sparse: float) -> None:
    """A lattice four times as fine weighs four times as much, or as little; the sum is n."""
    axis = np.arange(6.0)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.concatenate((lattice, lattice / 4 + 20))
    weights = density_weights(points, 8, weighting)  # type: ignore[arg-type]
    assert weights.sum() == pytest.approx(432)
    np.testing.assert_allclose(weights[216:] / weights[:216], dense_over_sparse, rtol=1e-6)


def test_k_nearest_neighbors_of_coinciding_points() -> None:
    """A point is never its own neighbour, even among many copies of itself."""
    points = np.concatenate((np.zeros((20, 3)), np.random.default_rng(0).normal(size=(30, 3))))
    index, distance = k_nearest_neighbors(points, 6)
    assert index.shape == distance.shape == (50, 6)
    assert (index != np.arange(50)[:, None]).all()
    assert (distance[:20] == 0).all() and (index[:20] < 20).all()
    assert k_nearest_neighbors(points[:4], 6)[0].shape == (4, 3)


def test_repulsion_needs_listed_neighbours() -> None:
    """More repelling neighbours than listed ones are refused."""
    with pytest.raises(ConfigError, match="not exceed neighbors"):
        configure("fast", {"method": "dco", "regularizers.neighbors": 5})


def small_problem(name: str, **overrides: object) -> Problem:
    """A cube that is to become a ball beside it."""
    axis = np.linspace(-2, 2, 9)
    cube = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = cube[np.linalg.norm(cube, axis=1) < 2.1] * 1.2 + [0.7, 0, 0]
    values = {"method": name, "descent.steps_per_frame": 4, **overrides}
    values |= {"dcd": {"refresh_frames": 2}, "shared_basis": {"cells": 4}}.get(name, {})
    return Problem(cube.astype(np.float32), ball.astype(np.float32), configure("published", values))


def make(name: str, **overrides: object) -> Method[Any]:
    """A method before its first frame."""
    return methods.find(name)(small_problem(name, **overrides))


CASES = [(name, {}) for name in POINT_METHODS] + [("dco", REGULARISED)]


@pytest.mark.usefixtures("float32_device")
@pytest.mark.parametrize(("name", "overrides"), CASES)
def test_a_restored_method_goes_on_bit_for_bit(name: str, overrides: dict[str, float]) -> None:
    """Positions, moments and weights after four frames equal those of a run resumed after two."""
    unbroken, resumed = make(name, **overrides), make(name, **overrides)
    for frame in range(3):
        unbroken.advance(frame)
    resumed.restore(unbroken.state())
    for frame in (3, 4):
        one, other = unbroken.advance(frame), resumed.advance(frame)
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_array_equal(one.d_rev, other.d_rev)
        assert one.numbers == other.numbers
    states = unbroken.state(), resumed.state()
    assert states[0].keys() == states[1].keys()
    for key in states[0]:
        np.testing.assert_array_equal(states[0][key], states[1][key])


@pytest.mark.usefixtures("float32_device")
@pytest.mark.parametrize("name", POINT_METHODS)
def test_what_goes_beyond_all_numbers_is_an_error(name: str) -> None:
    """The error names a remedy, and the last good state stands."""
    method = make(name, **{"descent.learning_rate": 1e30})
    before = method.state()["x"]
    with pytest.raises(SimulationError, match="after 0 frames: positions are not finite") as caught:
        method.advance(0)
    assert "learning rate" in caught.value.remedy
    np.testing.assert_array_equal(method.state()["x"], before)


@pytest.mark.usefixtures("float32_device")
@pytest.mark.parametrize("name", POINT_METHODS)
def test_methods_descend_their_loss(name: str) -> None:
    """With a small epsilon every method lowers what it minimises by a third in ten frames."""
    method = make(name, **{"descent.epsilon": 1e-8, "descent.steps_per_frame": 10})
    losses = [method.advance(frame).numbers["loss_points"] for frame in range(10)]
    assert losses[-1] < 2 / 3 * losses[0]


def test_positions_do_not_depend_on_threads() -> None:
    """One and two threads give the same bits, regularisers included."""
    config = tiny("published", "dco", **REGULARISED)
    runs = [list(morph("sphere", "star", config, device="cpu", threads=k)) for k in (1, 2)]
    np.testing.assert_array_equal(runs[0][-1].positions, runs[1][-1].positions)


def tiny(preset: str, method: str, **overrides: object) -> MorphConfig:
    """Two short frames at two points per cell edge."""
    values = {"sampling.points_per_cell_edge": 2, "frames": 2, "descent.steps_per_frame": 3}
    return configure(preset, {**values, "method": method, **overrides})


@pytest.mark.parametrize("preset", presets.general_names())
@pytest.mark.parametrize("name", POINT_METHODS)
def test_end_to_end_under_every_preset(name: str, preset: str) -> None:
    """The distance falls; there are no numbers of the physics, and fill on the last frame."""
    first, last = morph("sphere", "star", tiny(preset, name), device="cpu")
    assert last.metrics["two_sided"] < first.metrics["two_sided"]
    assert np.isfinite(last.metrics["loss_points"])
    assert {"kinetic_energy", "det_f_min", "loss_physics"}.isdisjoint(last.metrics)
    assert last.metrics["iou"] > 0


def test_a_run_that_stops_early_has_all_metrics() -> None:
    """Its last frame is measured as the last frame of any run."""
    stopping = {"stopping.patience": 1, "stopping.earliest_frame": 0, "stopping.tolerance": 100}
    config = tiny("published", "dco", frames=5, **stopping)
    first, last = morph("sphere", "star", config, device="cpu")
    assert last.events[-1].kind == "stopped"
    assert {"iou", "rho_p05", "outside_share"} <= last.metrics.keys() - first.metrics.keys()


def test_an_interrupted_run_resumes_from_its_file(tmp_path: Path) -> None:
    """Stopped after one frame and resumed, the file holds the positions of the unbroken run."""
    config = tiny("fast", "dcd")
    unbroken = list(morph("sphere", "star", config, device="cpu"))
    out = tmp_path / "run.vtkhdf"
    run = morph("sphere", "star", config, device="cpu", out=out)
    next(run)
    run.close()
    list(morph("sphere", "star", config, device="cpu", out=out, resume=True))
    with Trajectory(out) as trajectory:
        np.testing.assert_array_equal(trajectory.positions(1), unbroken[1].positions)


def test_estimates_tell_methods_apart() -> None:
    """Points alone need less time and memory than points with physics."""
    joint, dco = (estimate(40_000, 30_000, 40, method=name) for name in ("joint", "dco"))
    assert dco.memory_mb < joint.memory_mb
    assert dco.seconds < joint.seconds
