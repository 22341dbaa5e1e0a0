"""A morph through several shapes: what its legs have of each other, and what each has alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from chamfer_morph.worker.sandbox.derived_files import StoredSurface
from chamfer_morph.worker.tasks import reconstruct_surface
from morph_engine import Frame, Trajectory, configure, morph
from morph_engine.comparison import compare, measure_path
from morph_engine.errors import ConfigError, ResultError
from morph_engine.geometry.placement import place, placed
from morph_engine.geometry.sampling import Similarity
from morph_engine.geometry.shapes import make
from morph_engine.geometry.solid import Solid
from morph_engine.geometry.surface_reconstruction import reconstruct_surface as surface_of
from morph_engine.geometry.surface_reconstruction import surface_deviation
from morph_engine.metrics.path import neighbor_metrics
from morph_engine.morphing import prepare
from morph_engine.results.spool import SpoolReader

FRAMES = 3
TARGETS = ["torus", "star", "sphere"]


def small(method: str = "dco", **more: object):
    """A configuration that is quickly computed."""
    return configure(
        "fast", {"method": method, "frames": FRAMES, "sampling.points_per_cell_edge": 2, **more}
    )


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a morph from a sphere through a torus and a star and back."""
    out = tmp_path_factory.mktemp("legs") / "result.vtkhdf"
    for _ in morph("sphere", TARGETS, small(), device="cpu", out=out):
        pass
    return out


def test_each_frame_knows_its_leg_and_is_measured_against_its_target(result: Path) -> None:
    """Three legs of three frames; t->s of each is its own, and small at the end."""
    with Trajectory(result) as run:
        assert run.legs.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
        assert [run.frame_in_leg(frame) for frame in range(9)] == 3 * [0, 1, 2]
        assert [shape.name for shape in run.run.stops] == ["sphere", *TARGETS]
        assert run.run.closed
        t2s = run.metrics["t2s"].reshape(3, FRAMES)
        assert (t2s[:, -1] < t2s[:, 0]).all()
        fills = run.metrics["iou"].reshape(3, FRAMES)
        assert np.isfinite(fills[:, -1]).all() and np.isnan(fills[:, :-1]).all()


def test_the_surface_of_a_frame_is_measured_against_the_target_of_its_leg(
    result: Path, tmp_path: Path
) -> None:
    """And not against the last one."""
    with Trajectory(result) as run:
        positions, record = run.positions(FRAMES), run.run
    reconstruct_surface.run(result, FRAMES, tmp_path / "surfaces.npz")
    found = StoredSurface.load(tmp_path / "surfaces.npz").report["deviation"]
    surface = surface_of(positions, record.spacing_of(positions))
    of_leg, last = (
        surface_deviation(surface, placed(make(name), record.placement.target))
        for name in ("star", "sphere")
    )
    assert found == of_leg != last


def test_a_result_is_not_replaced_unless_asked_for(result: Path) -> None:
    """By a run that names the same file, not even by its first frame."""
    before = result.read_bytes()
    with pytest.raises(ResultError, match="already exists"):
        next(morph("sphere", "torus", small(), device="cpu", out=result))
    assert result.read_bytes() == before


def test_the_path_of_each_leg_is_measured_alone(result: Path) -> None:
    """As if it were a run of its own, which begins where the one before it has ended."""
    with Trajectory(result) as run:
        start, end = run.positions(FRAMES - 1), run.positions(2 * FRAMES - 1)
        kept = neighbor_metrics(start, end, run.config.spacing)["kept"]
        assert measure_path(run, 1)["kept"] == pytest.approx(kept)
        with pytest.raises(ResultError, match="leg 3"):
            measure_path(run, 3)


def test_a_frame_is_compared_with_the_target_of_its_leg(result: Path) -> None:
    """As the run has measured it."""
    with Trajectory(result) as run:
        for frame in (FRAMES - 1, 2 * FRAMES - 1, -1):
            measured = compare(run, frame=frame).values
            assert measured["s2t"] == pytest.approx(run.metrics_at(frame)["s2t"], rel=1e-4)


def test_a_frame_is_measured_by_the_spacing_of_its_leg(tmp_path: Path) -> None:
    """Particles that fill a smaller shape are closer, and their spacing is what counts there."""
    out = tmp_path / "result.vtkhdf"
    config = small(**{"sampling.fit": "none", "frames": 2})
    ball = make("sphere")
    smaller = replace(ball, vertices=0.8 * ball.vertices, name="smaller")
    for _ in morph(ball, [smaller, ball], config, device="cpu", out=out):
        pass
    with Trajectory(out) as run:
        assert run.run.leg(1).config.spacing < 0.9 * run.config.spacing
        for frame in (1, 3):
            measured, stored = compare(run, frame=frame).values, run.metrics_at(frame)
            for name in ("s2t_over_h", "iou"):
                assert measured[name] == pytest.approx(stored[name], rel=1e-4)


def test_a_leg_is_a_morph_that_begins_as_the_last_one_ended(result: Path) -> None:
    """The second leg has the bits of a morph whose source are the particles after the first."""
    with Trajectory(result) as run:
        start, wanted = run.positions(FRAMES - 1), run.positions(2 * FRAMES - 1)
        second = run.run.leg(1, start)
        np.testing.assert_array_equal(second.source_points, start)
        assert second.config.spacing == pytest.approx(
            0.5 * (len(run.run.target_points_of(0)) / len(start)) ** (1 / 3)
        )
    from morph_engine.morphing import run as compute

    *_, last = compute(second, device="cpu")
    np.testing.assert_array_equal(last.positions, wanted)


@pytest.mark.parametrize("finished", [2, FRAMES, FRAMES + 1])
def test_a_run_goes_on_bit_for_bit_from_any_frame_of_any_leg(
    result: Path, finished: int, tmp_path: Path
) -> None:
    """Stopped within a leg, at its end and in the next one."""
    out = tmp_path / "again.vtkhdf"
    frames = morph("sphere", TARGETS, small(), device="cpu", out=out)
    for _ in range(finished):
        next(frames)
    frames.close()
    reader = SpoolReader(out)
    assert reader.leg_of(finished - 1) == (finished - 1) // FRAMES
    assert reader.frame_in_leg(finished - 1) == (finished - 1) % FRAMES
    with Trajectory(out) as partial:
        assert (partial.status, len(partial)) == ("partial", finished)
    resumed: Sequence[Frame] = list(
        morph("sphere", TARGETS, small(), device="cpu", out=out, resume=True)
    )
    assert [frame.index for frame in resumed] == list(range(9))
    assert [frame.leg for frame in resumed] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    with Trajectory(result) as whole, Trajectory(out) as again:
        for frame in range(9):
            np.testing.assert_array_equal(again.positions(frame), whole.positions(frame))
            assert again.metrics_at(frame) == whole.metrics_at(frame)


def test_a_leg_that_improves_no_more_gives_way_to_the_next(tmp_path: Path) -> None:
    """Early stopping ends a leg, the frames count on, and coordinates reach those of each shape."""
    stopping = {"stopping.patience": 1, "stopping.earliest_frame": 0, "stopping.tolerance": 1e9}
    out = tmp_path / "result.vtkhdf"
    frames, placed = [], []
    for frame in morph("sphere", ["torus", "star"], small(**stopping), device="cpu", out=out):
        frames.append(frame)
        placed.append(SpoolReader(out).transform_at(min(frame.index, 1)))
    with Trajectory(out) as run:
        np.testing.assert_allclose(placed[-1], run.transform_at(1))
    assert [(frame.index, frame.leg) for frame in frames] == [(0, 0), (1, 0), (2, 1), (3, 1)]
    stops = [event for frame in frames for event in frame.events if event.kind == "stopped"]
    assert [event.frame for event in stops] == [1, 3]
    assert "iou" in frames[1].metrics and "iou" in frames[3].metrics


def test_the_default_method_carries_the_spacing_on() -> None:
    """A ball that grows to twice its volume and shrinks again ends as evenly filled as before."""
    ball = make("sphere")
    balls = [Similarity(scale).applied(ball) for scale in (0.7, 0.7 * 2 ** (1 / 3), 0.7)]
    settings = {"frames": 6, "sampling.fit": "none"}
    first, *targets = balls
    frames = list(morph(first, targets, small("flow", **settings), device="cpu"))
    radii = [float(np.linalg.norm(frame.positions, axis=1).max()) for frame in frames]
    assert radii[5] == pytest.approx(radii[11] * 2 ** (1 / 3), rel=0.02)
    assert frames[11].metrics["escaped"] == 0
    assert frames[11].metrics["t2s_over_h"] < 0.65
    assert frames[11].metrics["iou"] > 0.9


def test_one_target_in_a_list_is_a_plain_morph() -> None:
    """Its record has nothing that earlier versions did not know."""
    plain, listed = (prepare("sphere", target, small()) for target in ("star", ["star"]))
    assert plain.document() == listed.document()
    assert not {"via", "via_points"} & plain.document().keys()
    assert not {"via", "coordinates_of"} & plain.document()["placement"].keys()
    assert plain.arrays().keys() == {
        "source_points", "target_points", "source_vertices", "source_faces", "target_vertices",
        "target_faces",
    }  # fmt: skip


def test_landmarks_do_not_go_with_several_targets() -> None:
    """They belong to one pair of shapes, which the error says."""
    marks = [{"source": [0, 0, 0], "target": [0, 0, 0]}]
    with pytest.raises(ConfigError, match="Landmarks need exactly one target"):
        prepare("sphere", ["star", "torus"], small("flow", landmarks=marks))
    with pytest.raises(ConfigError, match="no target"):
        prepare("sphere", [], small())


def test_coordinates_do_not_jump_between_legs() -> None:
    """A built-in shape among the user's own has the coordinates of the one before it."""
    own = Solid(8.0, np.array([[99.0] * 3, [101.0] * 3]))
    built_in = Solid.of(make("sphere"))
    shapes = (built_in, own, built_in, built_in)
    placement = place(shapes[0], shapes[-1], via=shapes[1:-1], fit="auto")
    assert placement.coordinates_of == (1, 1, 1, 1)
    for before, after in pairwise(range(3)):
        assert placement.to_user(1.0, before) == placement.to_user(0.0, after)
    np.testing.assert_allclose(placement.to_user(0.5, 2).apply(np.zeros((1, 3))), 100, atol=1e-9)
