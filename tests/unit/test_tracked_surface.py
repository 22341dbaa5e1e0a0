"""Tracked surfaces: the same triangles in all frames, and on the surface of each."""

import io
import json
import struct
import zipfile

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from morph_engine.errors import ConfigError, MeshError
from morph_engine.export import export
from morph_engine.geometry.placement import Placement
from morph_engine.geometry.sampling import Similarity
from morph_engine.geometry.surface_reconstruction import Surface, reconstruct_surface
from morph_engine.geometry.surface_tracking import carried, mean_distance
from morph_engine.presets import configure
from morph_engine.results.playback import Playback
from morph_engine.results.run_record import RunRecord
from morph_engine.results.selection import Selection
from morph_engine.results.spool import Spool
from morph_engine.results.timeline import Timing
from morph_engine.results.tracked_surface import track_surface
from morph_engine.results.trajectory import Trajectory, write_result

H = 0.5
FRAMES = 9
NEAR = 0.1
"""How far a tracked surface may be from that of its frame on average, both ways [h]. Corners of the
two lie 0.02 h apart where nothing happens."""

DTYPES = {5120: np.int8, 5122: np.int16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC3": 3}


def stored(path, frames, to_user, to_target=None):
    """A result of particles that no simulation has moved; the target's map may be another one."""
    placement = Placement(source=to_user.inverse(), target=(to_target or to_user).inverse())
    config = configure("fast", {"sampling.points_per_cell_edge": 2, "frames": len(frames)})
    ends = frames[0], frames[-1]
    with Spool.create(path, RunRecord(config, *ends, *ends, placement=placement)) as spool:
        for index, positions in enumerate(frames):
            spool.append(index, positions, {})
        write_result(spool, status="complete")
        spool.remove()
    return path


def lattice(*sizes):
    """Lattice points within half edges about the origin, shape [n, 3]."""
    axes = [np.arange(-size + H / 2, size, H) for size in sizes]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def ring_frames():
    """A disc that becomes a ring: matter moves away from the axis, and keeps its volume."""
    disc = lattice(4, 1.5, 4)
    disc = disc[np.hypot(disc[:, 0], disc[:, 2]) < 4]
    away = np.hypot(disc[:, 0], disc[:, 2])[:, None]
    frames = []
    for hole in np.linspace(0, 3.5, FRAMES):
        outwards = np.sqrt(away**2 + hole**2) / away
        frames.append((disc * np.hstack([outwards, outwards**0, outwards])).astype(np.float32))
    return frames


def lump_frames():
    """A box out of which a leg grows: the topology stays."""
    box = lattice(2.5, 2, 2)
    frames = []
    for length in np.linspace(0, 2.5, FRAMES):
        middle = np.hypot(box[:, 1], box[:, 2]) < 1.2
        share = np.clip(box[:, 0], 0, None) / 2.5
        frames.append((box + np.outer(length * middle * share, [1, 0, 0])).astype(np.float32))
    return frames


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """A result in which the topology changes."""
    path = tmp_path_factory.mktemp("ring") / "ring.vtkhdf"
    with Trajectory(stored(path, ring_frames(), Similarity(0.1, (7.0, 8.0, 9.0)))) as opened:
        yield opened


@pytest.fixture(scope="module")
def lump(tmp_path_factory):
    """A result in which it stays."""
    path = tmp_path_factory.mktemp("lump") / "lump.vtkhdf"
    with Trajectory(stored(path, lump_frames(), Similarity())) as opened:
        yield opened


def selection(trajectory, frames=None, **options):
    """A tracked selection in grid units."""
    chosen = tuple(range(trajectory.frame_count)) if frames is None else frames
    options = {"units": "grid"} | options
    return Selection(trajectory, chosen, surface=True, tracked=True, **options)


def off(trajectory, mesh, frame):
    """How far a tracked mesh is from the surface of a frame [h]."""
    expected = reconstruct_surface(trajectory.positions(frame), H, cell_over_h=0.5)
    return mean_distance(Surface(mesh.vertices[mesh.frames.index(frame)], mesh.faces), expected) / H


def test_vertices_go_with_the_matter():
    """A shift carries vertices exactly, a turn to within 0.1 h: the fit leans towards shifts."""
    matter, generator = lattice(2, 2, 2), np.random.default_rng(1)
    vertices = generator.uniform(-2.2, 2.2, (50, 3))
    shift = np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(carried(vertices, matter, matter + shift, H), vertices + shift)
    turn = Rotation.from_rotvec([0, 0.2, 0]).as_matrix().T
    np.testing.assert_allclose(
        carried(vertices, matter, matter @ turn, H), vertices @ turn, atol=0.1 * H
    )


def test_particles_that_are_lost_carry_nothing():
    """One that is not a number changes nothing for the rest."""
    matter = lattice(2, 2, 2)
    moved = matter + 1
    moved[0] = np.nan
    np.testing.assert_allclose(carried(matter[:5], matter, moved, H), matter[:5] + 1)


def test_matter_that_is_lost_carries_nothing():
    """Two frames that have no particle in common have no motion between them."""
    matter = np.random.default_rng(0).random((20, 3))
    before, after = matter.copy(), matter.copy()
    before[:10], after[10:] = np.nan, np.inf
    with pytest.raises(MeshError, match="no particle in common"):
        carried(matter, before, after, H)


def test_one_mesh_where_the_topology_stays(lump):
    """Its triangles are closed in every frame and lie on the surface there."""
    found = track_surface(selection(lump))
    (mesh,) = found.meshes
    assert found.changes_at is None
    assert mesh.frames == tuple(range(FRAMES))
    assert mesh.vertices.shape == mesh.normals.shape
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=2), 1, atol=1e-6)
    for frame in mesh.frames:
        assert Surface(mesh.vertices[frame], mesh.faces).watertight
        assert off(lump, mesh, frame) < NEAR


def test_two_meshes_where_it_changes(ring):
    """The disc up to a frame, the ring from it on; both lie on the surface of their frames."""
    said = []
    found = track_surface(selection(ring, tell=said.append))
    disc, after = found.meshes
    assert disc.frames == tuple(range(found.changes_at + 1))
    assert after.frames == tuple(range(found.changes_at, FRAMES))
    assert [Surface(mesh.vertices[0], mesh.faces).euler for mesh in (disc, after)] == [2, 0]
    for mesh in (disc, after):
        for frame in set(mesh.frames) - {found.changes_at}:
            assert off(ring, mesh, frame) < NEAR
    assert f"frame {found.changes_at}" in said[0]


def test_some_frames_are_those_of_all(lump):
    """Frames between those that are asked for are followed, too."""
    (whole,) = track_surface(selection(lump)).meshes
    (some,) = track_surface(selection(lump, frames=(8, 0, 3))).meshes
    assert some.frames == (0, 3, 8)
    np.testing.assert_array_equal(some.vertices, whole.vertices[[0, 3, 8]])


def test_a_limit_of_vertices_is_kept(lump):
    """Triangles are larger then, and one is told."""
    said = []
    (mesh,) = track_surface(selection(lump, tell=said.append), vertex_limit=500).meshes
    assert 250 < mesh.vertices.shape[1] <= 500
    assert "500 vertices" in said[0]


def test_one_frame_has_no_motion(lump, tmp_path):
    """It is refused before a file is written."""
    with pytest.raises(ConfigError, match="two or more frames"):
        export(lump, tmp_path / "a.glb", "glb", frames=[2], tracked=True)
    assert not list(tmp_path.iterdir())


class Glb:
    """The parts of a GLB file."""

    def __init__(self, path):
        data = path.read_bytes()
        length = struct.unpack_from("<I", data, 12)[0]
        self.json = json.loads(data[20 : 20 + length])
        self._binary = data[28 + length :]

    def array(self, index):
        """The numbers of an accessor; shares of the largest integer where it is normalized."""
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        kind, width = np.dtype(DTYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        stride = view.get("byteStride", width * kind.itemsize)
        raw = np.frombuffer(self._binary, np.uint8, stride * accessor["count"], view["byteOffset"])
        rows = np.ascontiguousarray(raw.reshape(-1, stride)[:, : width * kind.itemsize])
        values = rows.view(kind).astype(np.float64)
        return values / np.iinfo(kind).max if accessor.get("normalized") else values

    def shown(self, node, target):
        """Positions in the scene and directions of the normals at a target; None: at rest."""
        place = self.json["nodes"][node]
        (primitive,) = self.json["meshes"][place["mesh"]]["primitives"]
        scale = next(
            (self.array(sampler["output"]).max() for sampler in self._samplers(node, "scale")),
            place["scale"],
        )
        shown = [self.array(primitive["attributes"][name]) for name in ("POSITION", "NORMAL")]
        if target is not None:
            for values, name in zip(shown, ("POSITION", "NORMAL"), strict=True):
                values += self.array(primitive["targets"][target][name])
        normals = shown[1] / np.linalg.norm(shown[1], axis=1, keepdims=True)
        return shown[0] * scale + place["translation"], normals

    def _samplers(self, node, path):
        (animation,) = self.json["animations"]
        for channel in animation["channels"]:
            if channel["target"] == {"node": node, "path": path}:
                yield animation["samplers"][channel["sampler"]]

    def nodes(self, name):
        """Indices of the nodes of a name."""
        return [i for i, node in enumerate(self.json["nodes"]) if node["name"] == name]

    def played(self, name, key):
        """Positions of the corners of the mesh of a name at a key of its animation."""
        nodes = self.json["nodes"]
        (node,) = self.nodes(name)
        (carrier,) = (i for i, each in enumerate(nodes) if node in each.get("children", []))
        (primitive,) = self.json["meshes"][nodes[node]["mesh"]]["primitives"]
        shown = self.array(primitive["attributes"]["POSITION"])
        weights = self.keys(node, "weights")[1].reshape(-1, len(primitive["targets"]))[key]
        for target, weight in zip(primitive["targets"], weights, strict=True):
            shown += weight * self.array(target["POSITION"])
        translation, scale = (self.keys(carrier, path)[1] for path in ("translation", "scale"))
        return shown * scale[key] + translation[key]

    def keys(self, node, path):
        """Times and values of a property of a node."""
        (sampler,) = self._samplers(node, path)
        return self.array(sampler["input"])[:, 0], self.array(sampler["output"])


def test_glb_moves_in_the_user_s_units(ring, tmp_path):
    """Each target shows its frame where the user's files have it, with that frame's normals."""
    path = export(ring, tmp_path / "ring.glb", "glb", tracked=True, fps=10)
    found = track_surface(selection(ring, units="user"))
    file = Glb(path)
    extent = np.ptp(found.meshes[0].vertices)
    for node, mesh in enumerate(found.meshes):
        for frame in range(len(mesh.frames)):
            vertices, normals = file.shown(node, frame - 1 if frame else None)
            np.testing.assert_allclose(vertices, mesh.vertices[frame], atol=extent / 32767)
            angle = np.degrees(np.arccos(np.clip((normals * mesh.normals[frame]).sum(1), -1, 1)))
            assert np.quantile(angle, 0.99) < 1  # 8 bits are good for 0.3 degrees
        times, weights = file.keys(node, "weights")
        np.testing.assert_allclose(times, np.array(mesh.frames) / 10, rtol=1e-6)
        expected = np.eye(len(times))[:, 1:]
        np.testing.assert_array_equal(weights.reshape(expected.shape), expected)
    change = found.changes_at / 10
    for node, visible in ((0, [True, False]), (1, [False, True])):
        times, scales = file.keys(node, "scale")
        np.testing.assert_allclose(times, [0, change], rtol=1e-6)
        assert (scales.reshape(2, 3) > 0).all(axis=1).tolist() == visible
    assert file.json["scenes"][0]["extras"]["topology_changes_at_frame"] == found.changes_at


FAR_AWAY = (
    (Similarity(0.2), Similarity(0.2, (500.0, 0.0, 0.0))),
    (Similarity(0.008), Similarity(400.0, (9000.0, -7000.0, 0.0))),
    (Similarity(400.0, (9000.0, -7000.0, 0.0)), Similarity(0.008)),
)
"""From near to far, from small to large and far, and back: grid units to those of either end."""


def sharpness(vertices):
    """A ten-thousandth of a mesh, and what single precision rounds off where it is."""
    return 1e-4 * np.ptp(vertices, axis=0).max() + np.spacing(np.float32(np.abs(vertices).max()))


@pytest.mark.parametrize("ends", FAR_AWAY)
@pytest.mark.parametrize("frames", [lump_frames(), ring_frames()], ids=["lump", "ring"])
def test_glb_is_as_sharp_where_it_goes_far_or_grows_much(tmp_path, ends, frames):
    """In each frame, beside the mesh as it is there; one mesh at a time is shown."""
    with Trajectory(stored(tmp_path / "r.vtkhdf", frames, *ends)) as result:
        path = export(result, tmp_path / "far.glb", "glb", tracked=True)
        found = track_surface(selection(result, units="user"))
    file = Glb(path)
    names = ("surface", "surface after")
    for mesh, name in zip(found.meshes, names, strict=False):
        for key, vertices in enumerate(mesh.vertices):
            assert np.abs(file.played(name, key) - vertices).max() < sharpness(vertices)
    for second in range(len(found.meshes) if found.changes_at else 0):
        (node,) = file.nodes(names[second])
        assert file.keys(node, "scale")[1][:, 0].tolist() == [1 - second, second]


@pytest.mark.parametrize(
    ("ends", "easing"), list(zip(FAR_AWAY, ("overshoot", "overshoot", "in-out"), strict=True))
)
def test_a_timed_glb_is_where_its_frames_are_mixed(tmp_path, ends, easing):
    """Between two frames and beyond the last one vertices are mixed, whatever carries them."""
    timing = Timing(2, 10, easing=easing)
    with Trajectory(stored(tmp_path / "r.vtkhdf", lump_frames(), *ends)) as result:
        path = export(result, tmp_path / "far.glb", "glb", tracked=True, timing=timing)
        (mesh,) = track_surface(selection(result, units="user")).meshes
        playback = Playback(result, timing)
    file = Glb(path)
    for key, moment in enumerate(playback.moments):
        mixed = sum(share * mesh.vertices[frame] for frame, share in playback.frames(moment))
        assert np.abs(file.played("surface", key) - mixed).max() < sharpness(mixed)


def test_a_mesh_that_shrinks_past_its_end_is_not_turned_inside_out(tmp_path):
    """Beyond the last frame the mirror image of its way has sizes below zero."""
    timing = Timing(2, 10, easing="overshoot")
    with Trajectory(stored(tmp_path / "r.vtkhdf", lump_frames(), *FAR_AWAY[2])) as result:
        path = export(result, tmp_path / "far.glb", "glb", tracked=True, timing=timing)
    file = Glb(path)
    (carrier,) = file.nodes("surface, place")
    scales = file.keys(carrier, "scale")[1]
    assert 0 < scales.min() < 0.1


def test_glb_is_the_same_twice_and_small(lump, tmp_path):
    """Twelve bytes per vertex and frame, next to the first frame and the triangles."""
    paths = [export(lump, tmp_path / name, "glb", tracked=True) for name in ("one.glb", "two.glb")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    count = Glb(paths[0]).json["accessors"][0]["count"]
    assert paths[0].stat().st_size < count * (12 * (FRAMES - 1) + 24 + 24) + 20_000


def test_usd_has_triangles_without_time_samples(ring, tmp_path):
    """Positions and normals have them; one mesh at a time is visible."""
    path = export(ring, tmp_path / "ring.usdc", "usd", tracked=True, fps=30)
    found = track_surface(selection(ring, units="user"))
    stage = Usd.Stage.Open(str(path))
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 30
    prim = stage.GetDefaultPrim()
    assert prim.GetCustomDataByKey("topologyChangesAtFrame") == found.changes_at
    for shape, mesh in zip(prim.GetChildren(), found.meshes, strict=True):
        shown = UsdGeom.Mesh(shape)
        assert shown.GetFaceVertexIndicesAttr().GetNumTimeSamples() == 0
        np.testing.assert_array_equal(shown.GetFaceVertexIndicesAttr().Get(), mesh.faces.ravel())
        for frame, vertices, normals in zip(mesh.frames, mesh.vertices, mesh.normals, strict=True):
            np.testing.assert_allclose(shown.GetPointsAttr().Get(frame), vertices, atol=1e-5)
            np.testing.assert_allclose(shown.GetNormalsAttr().Get(frame), normals, atol=1e-6)
            before = frame < found.changes_at
            visible = shown.ComputeVisibility(frame) == UsdGeom.Tokens.inherited
            assert visible == (before == (mesh is found.meshes[0]))


def test_point_cache_moves_the_mesh_beside_it(ring, tmp_path):
    """As other programs read both: vertices in the same order, the first sample where the mesh is.

    Where the topology changes, each mesh has a cache of its own frames.
    """
    path = export(ring, tmp_path / "ring.zip", "pc2", tracked=True)
    again = export(ring, tmp_path / "again.zip", "pc2", tracked=True)
    assert path.read_bytes() == again.read_bytes()
    found = track_surface(selection(ring, units="user"))
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert [*files] == ["surface.obj", "surface.pc2", "surface-after.obj", "surface-after.pc2"]
    for name, mesh in zip(("surface", "surface-after"), found.meshes, strict=True):
        cache = files[f"{name}.pc2"]
        assert cache[:16] == b"POINTCACHE2\0\1\0\0\0"
        count, samples = (int.from_bytes(cache[at : at + 4], "little") for at in (16, 28))
        assert [*np.frombuffer(cache, "<f4", 2, 20)] == [mesh.frames[0], 1.0]
        assert (samples, count) == mesh.vertices.shape[:2]
        places = np.frombuffer(cache, "<f4", offset=32).reshape(samples, count, 3)
        np.testing.assert_allclose(places, mesh.vertices, atol=1e-5)
        still = trimesh.load(io.BytesIO(files[f"{name}.obj"]), "obj", process=False)
        np.testing.assert_allclose(still.vertices, places[0], atol=1e-5)
        np.testing.assert_array_equal(still.faces, mesh.faces)


def test_point_cache_counts_the_frame_in_which_the_topology_changes(ring, tmp_path):
    """It is shown by both meshes, and at uneven distances where it was not asked for."""
    change = track_surface(selection(ring)).changes_at
    step = next(step for step in (2, 3, 4) if change % step)
    chosen = range(0, FRAMES, step)
    with pytest.raises(ConfigError, match=f"frames .*{change}.* are not"):
        export(ring, tmp_path / "ring.zip", "pc2", tracked=True, frames=chosen)


@pytest.mark.parametrize(
    ("name", "format", "options", "words"),
    [
        ("a.zip", "pc2", {"frames": [0, 1, 3]}, "evenly spaced"),
        ("a.pc2", "pc2", {}, r"\.zip"),
        ("a.ply", "ply", {}, "glb"),
        ("a.csv", "csv", {}, "not support tracked"),
        ("a.zip", "glb", {}, r"\.glb"),
        ("a.glb", "glb", {"fields": ["speed"]}, "cannot have fields"),
    ],
)
def test_refusals(lump, tmp_path, name, format, options, words):
    """What a tracked surface cannot be is refused with a remedy."""
    with pytest.raises(ConfigError, match=words):
        export(lump, tmp_path / name, format, tracked=True, **options)
    assert not list(tmp_path.iterdir())
