"""Where shapes of any size and place are in the domain, and how results come back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from morph_engine.errors import MeshError
from morph_engine.geometry import rotation as rotations
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.placement import Placement, place, placed
from morph_engine.geometry.sampling import HALF_EXTENT, REFERENCE_VOLUME, Fit, Similarity
from morph_engine.geometry.shapes import make, names
from morph_engine.geometry.solid import Solid
from morph_engine.morphing import prepare
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord
from morph_engine.sections import PlacementConfig, PoseConfig

COARSE = {"sampling.points_per_cell_edge": 2}
AS_IT_IS = Similarity()


def solid(lower, upper, **more) -> Solid:
    """A box."""
    bounds = np.array([lower, upper], float)
    return Solid(float(np.prod(bounds[1] - bounds[0])), bounds, **more)


def cube(edge: float, centre: float = 0.0) -> Solid:
    """A cube whose centre is the same along all axes."""
    return solid([centre - edge / 2] * 3, [centre + edge / 2] * 3)


def moved(mesh, scale: float, offset, axes=(0, 1, 2)):
    """A user's mesh: another one with other units, place and axes."""
    vertices = mesh.vertices[:, axes] * scale + np.asarray(offset, float)
    faces = mesh.faces if axes == (0, 1, 2) else mesh.faces[:, ::-1]
    return replace(mesh, vertices=vertices, faces=faces, built_in=False)


@pytest.mark.parametrize("name", [*names(), "text:HI", "text:MORPHING", "text:ABCDEFGHIJKLMNOP"])
def test_built_in_shapes_stay_as_they_are(name):
    """Each is made for the domain, whatever its volume."""
    shape = Solid.of(make(name))
    placement = place(shape, Solid.of(make("sphere")), fit="auto")
    assert (placement.source, placement.target, placement.message) == (AS_IT_IS, AS_IT_IS, "")


def test_shapes_of_usual_size_stay_where_they_are():
    """Off the centre and with other sizes, as long as they are within a factor of two."""
    placement = place(cube(8.0, 7.0), cube(16.0), fit="auto")
    assert (placement.source, placement.target) == (AS_IT_IS, AS_IT_IS)


@pytest.mark.parametrize("scale", [0.001, 1.0, 1000.0])
def test_shapes_made_for_each_other_keep_their_places(scale):
    """One similarity for both, which gives the source the usual volume."""
    source, target = cube(30 * scale, 500 * scale), cube(36 * scale, 502 * scale)
    placement = place(source, target, fit="auto")
    assert placement.source == placement.target
    assert source.volume * placement.source.scale**3 == pytest.approx(REFERENCE_VOLUME)
    assert "moved together" in placement.message


def test_shapes_far_apart_keep_their_sizes():
    """One scale for both, each centred."""
    placement = place(cube(0.2, 5.0), cube(0.25, -90.0), fit="auto")
    assert placement.source.scale == placement.target.scale
    assert placement.source.offset[0] == pytest.approx(-5 * placement.source.scale)
    assert placement.target.offset[0] == pytest.approx(90 * placement.source.scale)
    assert "each is centred" in placement.message


def test_shapes_of_other_units_get_one_volume():
    """Metres and millimetres are made equal."""
    source, target = cube(0.1), cube(100.0)
    placement = place(source, target, fit="auto")
    for each, found in ((source, placement.source), (target, placement.target)):
        assert each.volume * found.scale**3 == pytest.approx(REFERENCE_VOLUME)
    assert "the source is scaled by 112 and the target by 0.112" in placement.message.lower()


def test_only_what_needs_it_is_scaled():
    """A built-in shape stays when a small mesh is to become of it."""
    placement = place(Solid.of(make("sphere")), cube(2.8), fit="auto")
    assert placement.source == AS_IT_IS
    assert placement.message.startswith("The target is scaled by 3.99 and centred")
    aside = solid([13, -7, -7], [27, 7, 7])  # beside a file, both would be moved together
    assert place(Solid.of(make("sphere")), aside, fit="auto").source == AS_IT_IS


@pytest.mark.parametrize("half_extent", [8.0, 16.0, 40.0])
@pytest.mark.parametrize("size", [(1, 1, 60), (60, 60, 0.5), (1e-3, 2e-3, 5e-3), (1e5, 1, 1)])
def test_whatever_the_shape_it_ends_in_the_domain(half_extent, size):
    """Thin, long, tiny and huge boxes, off the centre, in smaller and larger domains."""
    shape = solid(np.full(3, 7.0), np.full(3, 7.0) + size)
    placement = place(shape, cube(1.0), fit="auto", half_extent=half_extent)
    assert np.abs(placement.source.apply(shape.bounds)).max() <= half_extent
    assert np.abs(placement.target.apply(cube(1.0).bounds)).max() <= half_extent


def test_a_point_cloud_stays_as_it_is():
    """Clouds are in grid units; the mesh beside one is placed for itself."""
    placement = place(None, cube(0.5), fit="auto")
    assert placement.source == AS_IT_IS and placement.target.scale == pytest.approx(22.3, rel=0.01)


def test_results_begin_at_the_source_and_end_at_the_target():
    """In the coordinates of each exactly; half-way by the mean factor and the mean place."""
    source, target = Similarity(2.0, (1.0, 2.0, 3.0)), Similarity(0.5, (-5.0, 0.0, 4.0))
    placement = Placement(source=source, target=target)
    assert placement.to_user(0.0) == source.inverse()
    assert placement.to_user(1.0) == target.inverse()
    half = placement.to_user(0.5)
    assert half.scale == pytest.approx(1.0)
    ends = np.add(source.inverse().offset, target.inverse().offset)
    np.testing.assert_allclose(half.offset, ends / 2)


@pytest.mark.parametrize("built_in", ["source", "target"])
def test_a_built_in_shape_has_the_coordinates_of_the_file(built_in):
    """It comes from no file, so that results have those of the other shape all the time."""
    shapes = {"source": cube(2.8), "target": cube(2.8)}
    shapes[built_in] = Solid.of(make("star"))
    placement = place(**shapes, fit="auto")
    own = placement.target if built_in == "source" else placement.source
    assert own != AS_IT_IS
    assert placement.to_user(0.0) == placement.to_user(1.0) == own.inverse()


@pytest.mark.parametrize("axes", [(0, 1, 2), (0, 2, 1)], ids=["y up", "z up"])
@pytest.mark.parametrize("scale", [0.001, 1.0, 1000.0])
def test_any_mesh_runs_and_comes_back(scale, axes):
    """A heart and a teapot in any unit, off the centre, on any axis, need no setting.

    Particles lie in the boxes of the user's meshes and reach within two lattice spacings of their
    faces (tips are thin), which are to rounding where they were.
    """
    source = moved(make("heart"), scale, np.array([40.0, -900.0, 3.0]) * scale, axes)
    target = moved(make("teapot"), scale, np.array([-7.0, 30.0, 0.0]) * scale, axes)
    record = prepare(source, target, configure(overrides=COARSE))
    restored = RunRecord.restore(record.document(), record.arrays())
    assert restored.placement == record.placement
    ends = (
        (source, record.source_points, restored.transform_to("user", 0.0)),
        (target, record.target_points, restored.transform_to("user", 1.0)),
    )
    for mesh, points, matrix in ends:
        assert np.abs(points).max() <= HALF_EXTENT
        assert 5_000 < len(points) < 20_000
        back = points @ matrix[:3, :3].T + matrix[:3, 3]
        slack = 2 * record.config.spacing * matrix[0, 0]
        lower, upper = mesh.bounds
        assert (back >= lower - slack).all() and (back <= upper + slack).all()
        np.testing.assert_allclose(back.min(axis=0), lower, atol=slack)
        np.testing.assert_allclose(back.max(axis=0), upper, atol=slack)
    for role, mesh, share in (("source", source, 0.0), ("target", target, 1.0)):
        fitted, _ = restored.fitted(role)
        matrix = restored.transform_to("user", share)
        back = fitted.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        size = np.ptp(mesh.bounds, axis=0).max()
        np.testing.assert_allclose(back, mesh.vertices, rtol=0, atol=1e-5 * size)


def test_the_papers_presets_place_nothing():
    """What repeats the paper takes meshes as they are."""
    for preset in ("published", "paper"):
        assert configure(preset).sampling.fit == "none"
    assert configure().sampling.fit == "auto"


def test_a_mesh_that_stays_is_the_same_object():
    """Nothing is computed, so that no bit can change."""
    mesh = make("sphere")
    assert placed(mesh, Similarity()) is mesh


def pose(**settings) -> PlacementConfig:
    """A pose of the target."""
    return PlacementConfig(target=PoseConfig(**settings))


def test_three_angles_are_turns_about_x_y_and_z():
    """As three.js and SciPy have them in the order XYZ, which its matrices show."""
    angles = (20.0, -70.0, 130.0)
    expected = Rotation.from_euler("XYZ", angles, degrees=True)
    found = rotations.from_euler(angles)
    np.testing.assert_allclose(rotations.matrix(found), expected.as_matrix(), atol=1e-15)


def test_a_rotation_half_way_is_as_far_from_both():
    """By half the angle, about the same axis."""
    first, last = rotations.about_axis(1, 10.0), rotations.about_axis(1, 250.0)
    half = rotations.matrix(rotations.between(first, last, 0.5))
    np.testing.assert_allclose(half, rotations.matrix(rotations.about_axis(1, -50.0)), atol=1e-12)


def test_a_similarity_and_its_inverse_undo_each_other():
    """To rounding, for any scale, rotation and offset; and so do two in a row."""
    there = Similarity(3e-3, (5.0, -70.0, 0.1), rotations.from_euler((10.0, 200.0, -35.0)))
    points = np.random.default_rng(0).normal(scale=1000.0, size=(50, 3))
    np.testing.assert_allclose(there.inverse().apply(there.apply(points)), points, rtol=1e-11)
    both = there.inverse().after(there)
    np.testing.assert_allclose(both.matrix, np.eye(4), atol=1e-12)
    homogeneous = np.c_[points, np.ones(50)] @ there.matrix.T
    np.testing.assert_allclose(homogeneous[:, :3], there.apply(points), rtol=1e-12)


def test_a_target_that_stands_on_another_axis_is_turned():
    """Its z comes to point along y, and the other way round; its centre stays the centre."""
    for upright, other in (("y", "z"), ("z", "y")):
        tall = solid([-2, -2, -6], [2, 2, 6]) if other == "z" else solid([-2, -6, -2], [2, 6, 2])
        source, target = replace(cube(11.0), up=upright), replace(tall, up=other)
        placement = place(source, target, fit="volume")
        half = np.ptp(placement.target.box(tall.bounds), axis=0) / 2
        axis = 1 if upright == "y" else 2
        assert placement.up == upright and half.argmax() == axis
        assert f"The target is rotated by 90 degrees about x, since {other}" in placement.turning
        upwards = placement.target.apply(np.eye(3)["yz".index(other) + 1]) - np.array(
            placement.target.offset
        )
        assert upwards[axis] > 0
        back = placement.to_user(1.0).apply(placement.target.apply(tall.bounds))
        np.testing.assert_allclose(back, tall.bounds, atol=1e-12)


@pytest.mark.parametrize("ups", [("z", "z"), ("y", "y"), (None, "z"), ("z", None), (None, None)])
def test_what_stands_alike_or_tells_nothing_is_not_turned(ups):
    """To the bit what it was before shapes had an upward axis."""
    source, target = cube(0.2, 5.0), cube(0.25, -90.0)
    before = place(source, target, fit="auto")
    turned = place(replace(source, up=ups[0]), replace(target, up=ups[1]), fit="auto")
    assert (turned.source, turned.target) == (before.source, before.target)
    assert turned.turning == "" and turned.up == (ups[0] or ups[1] or "y")


def test_a_pose_overrules_what_a_file_tells():
    """Who says that both have y up gets no turn."""
    source, target = replace(cube(11.0), up="y"), replace(cube(11.0), up="z")
    assert place(source, target, fit="auto", poses=pose(up="y")).target == AS_IT_IS


def test_a_shape_is_turned_scaled_and_moved_about_its_centre():
    """Beside what the fit does: as large and where it is asked for, and back where it was."""
    box = solid([3, -2, -2], [11, 2, 2])
    poses = pose(rotate=(0, 90, 0), scale=0.5, move=(1, 2, 3))
    found = place(cube(11.0), box, fit="none", poses=poses)
    lower, upper = found.target.box(box.bounds)
    np.testing.assert_allclose((lower + upper) / 2, [8, 2, 3], atol=1e-12)
    np.testing.assert_allclose(upper - lower, [2, 2, 4], atol=1e-12)
    back = found.to_user(1.0).apply(found.target.apply(box.bounds))
    np.testing.assert_allclose(back, box.bounds, atol=1e-12)


def test_a_pose_that_leaves_the_domain_is_refused():
    """With the setting that mends it."""
    with pytest.raises(MeshError, match=r"the target reaches 20\.5 grid units") as error:
        place(cube(11.0), cube(11.0), fit="auto", poses=pose(move=(15, 0, 0)))
    assert "placement.target.scale" in error.value.remedy


def test_built_in_shapes_keep_the_pose_that_is_asked_for():
    """They come from no file, so that results go back to none: they are turned in them, too."""
    star = Solid.of(make("star"))
    placement = place(star, star, fit="auto", poses=pose(rotate=(0, 0, 90)))
    assert placement.to_user(1.0) == AS_IT_IS != placement.target


@pytest.mark.parametrize(
    ("name", "turned", "up"),
    [
        ("cone.glb", False, "y"),
        ("cone.stl", False, "z"),
        ("cone.obj", False, "z"),
        ("cone.ply", True, "y"),
        ("ball.obj", False, None),
        ("slab.obj", False, None),
    ],
)
def test_the_upward_axis_is_guessed_from_honest_evidence(tmp_path, name, turned, up):
    """By the format where that tells, by a flat base on one axis only, and else not at all."""
    kind = name.partition(".")[0]
    mesh = {
        "cone": trimesh.creation.cone(radius=4.0, height=8.0),
        "ball": trimesh.creation.icosphere(radius=4.0),
        "slab": trimesh.creation.cylinder(radius=4.0, height=1.0),
    }[kind]
    if turned:
        mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    mesh.export(tmp_path / name)
    assert load_mesh(tmp_path / name).up == up


def test_shapes_that_are_taken_as_they_are_are_not_turned():
    """Whatever their files tell, as by the paper's presets; the viewer has the source upright."""
    source, target = replace(cube(11.0), up="z"), replace(cube(11.0), up="y")
    placement = place(source, target, fit="none")
    assert placement.target == placement.source == AS_IT_IS
    assert (placement.up, placement.turning) == ("z", "")
    assert place(source, target, fit="none", poses=pose(up="y")).target != AS_IT_IS


@pytest.mark.parametrize("fit", ["auto", "volume", "extent"])
@pytest.mark.parametrize("half_extent", [8.0, 16.0, 32.0])
def test_each_fit_leaves_shapes_in_the_domain(fit: Fit, half_extent: float) -> None:
    """Of any size."""
    long = solid([-1.5, -0.5, -0.5], [1.5, 0.5, 0.5])
    found = place(long, long, fit=fit, half_extent=half_extent)
    assert np.abs(found.source.apply(long.bounds)).max() < half_extent
