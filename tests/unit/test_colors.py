"""Colours of a morph: those of its shapes at either end, mixed between, wherever it is shown.

The tolerance at the ends is 2 in CIE 1976 colour difference; where it says "exact", a level of 255.
"""

from __future__ import annotations

import io
import json
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image

from chamfer_morph.worker.frame_reader import read_colors
from chamfer_morph.worker.sandbox.derived_files import StoredSurface
from chamfer_morph.worker.tasks import reconstruct_surface
from morph_engine import srgb
from morph_engine.errors import ConfigError, ExtraError
from morph_engine.export import export
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.mesh_colors import nearest_colors
from morph_engine.geometry.splats import HARMONIC
from morph_engine.morphing import morph, prepare
from morph_engine.presets import configure
from morph_engine.rendering import pictures
from morph_engine.rendering.pictures import video
from morph_engine.results.playback import Playback
from morph_engine.results.run_record import RunRecord
from morph_engine.results.selection import Selection
from morph_engine.results.spool import Spool
from morph_engine.results.timeline import Timing
from morph_engine.results.trajectory import Trajectory, write_result
from tests.color_difference import differences

COUNT = 12
"""Frames of a leg: in the first one, colours have gone 2 % of the way."""

STILL_TO_SEE = 2.0
"""CIE 1976 colour difference that is hardly seen."""

GREY = 0.5

SETTINGS = {"sampling.points_per_cell_edge": 1, "sampling.fit": "volume", "frames": COUNT}


def picture(first, second, size=96):
    """A smooth picture from one colour at its left to another at its right, darker downwards."""
    across, down = np.meshgrid(np.linspace(0, 1, size), np.linspace(1, 0.6, size))
    mixed = np.multiply.outer(1 - across, first) + np.multiply.outer(across, second)
    return Image.fromarray(np.rint(mixed * down[..., None]).astype(np.uint8))


def textured_ball(path, image, along=(1, 1, 1)):
    """A mesh file of a ball, or an egg, under a picture that is projected along z."""
    shape = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    uv = (shape.vertices[:, :2] / 5 * 0.9 + 1) / 2
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    shape.vertices *= along
    shape.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    shape.export(path)
    return load_mesh(path)


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball from orange to blue."""
    image = picture((240, 140, 40), (40, 90, 220))
    return textured_ball(tmp_path_factory.mktemp("ball") / "ball.glb", image)


@pytest.fixture(scope="module")
def egg(tmp_path_factory):
    """An egg from green to violet."""
    image = picture((40, 200, 90), (150, 60, 200))
    return textured_ball(tmp_path_factory.mktemp("egg") / "egg.glb", image, (1, 1.5, 1))


def steady(record, path, legs=1):
    """A run whose matter goes from each shape to the next evenly, by an affine map."""
    bounds = [
        np.ptp(record.placement.stops[k].applied(shape).bounds, axis=0)
        for k, shape in enumerate(record.stops)
    ]
    with Spool.create(path, record) as spool:
        for leg in range(legs):
            for frame in range(COUNT):
                share = (frame + 1) / COUNT
                size = bounds[leg] + share * (bounds[leg + 1] - bounds[leg])
                positions = record.source_points * (size / bounds[0])
                spool.append(spool.frame_count, positions.astype(np.float32), {"s2t": 1}, leg=leg)
        write_result(spool, status="complete")
    return path


@pytest.fixture(scope="module")
def result(ball, egg, tmp_path_factory):
    """The ball becomes the egg."""
    record = prepare(ball, egg, configure("fast", SETTINGS))
    return steady(record, tmp_path_factory.mktemp("run") / "egg.vtkhdf")


@pytest.fixture(scope="module")
def run(result):
    """That run, open."""
    with Trajectory(result) as opened:
        yield opened


def original(mesh, points):
    """sRGB of a mesh at the points of its surface nearest to some points."""
    return srgb.to_bytes(nearest_colors(points, mesh.vertices, mesh.faces, mesh.colors))


def snapshots(run, *, surface, frames, units="user"):
    """Some frames as they are exported."""
    return list(Selection(run, frames, surface=surface, units=units).snapshots())


@pytest.mark.parametrize("surface", [False, True])
def test_both_ends_have_the_colours_of_the_originals(run, ball, egg, surface):
    """The last frame everywhere; the first one has gone 2 % of the way already."""
    (last,) = snapshots(run, surface=surface, frames=(COUNT - 1,))
    assert differences(last.colors, original(egg, last.vertices)).max() < STILL_TO_SEE
    begin = Selection(run, (0,), surface=surface, units="source")
    (first,) = begin.snapshots()
    assert np.median(differences(first.colors, original(ball, first.vertices))) < STILL_TO_SEE


def test_a_film_begins_with_the_colours_of_the_source(run, ball):
    """Its first picture shows the source itself, and its surface is as exact as the end's."""
    playback = Playback(run, Timing(seconds=1, fps=2))
    selection = Selection(run, (0,), surface=True, units="source")
    first = next(iter(selection.played(playback)))
    assert differences(first.colors, original(ball, first.vertices)).max() < STILL_TO_SEE


def test_colours_between_are_mixed_in_linear_light(run):
    """By 3 s^2 - 2 s^3 of what the particles have in both shapes, and ever nearer to the end."""
    begin, end = srgb.from_bytes(run.colors)
    for frame, snapshot in enumerate(snapshots(run, surface=False, frames=range(COUNT))):
        s = (frame + 1) / COUNT
        share = 3 * s**2 - 2 * s**3
        expected = srgb.to_bytes(begin + share * (end - begin))
        assert np.array_equal(snapshot.colors, expected)


def test_surfaces_between_lie_between(run):
    """Halfway the surface is about as far from the colours of one end as of the other."""
    middle = COUNT // 2 - 1
    (halfway,) = snapshots(run, surface=True, frames=(middle,), units="grid")
    begin, end = (
        original(mesh, mesh.bounds.mean(axis=0) + directions)
        for mesh, directions in (
            (run.run.fitted(role)[0], halfway.vertices * scale)
            for role, scale in (("source", (1, 1.24, 1)), ("target", (1, 0.82, 1)))
        )
    )
    expected = srgb.to_bytes((srgb.from_bytes(begin) + srgb.from_bytes(end)) / 2)
    assert np.median(differences(halfway.colors, expected)) < STILL_TO_SEE


def test_ply_and_glb_and_obj_have_the_colours(result, run, egg, tmp_path):
    """PLY and OBJ in sRGB, GLB in linear light: read again, all are as the original."""
    for name in ("last.ply", "last.glb", "last.obj"):
        path = export(result, tmp_path / name, name[-3:], surface=True)
        mesh = load_mesh(path)
        points = mesh.vertices
        assert differences(original(mesh, points), original(egg, points)).max() < STILL_TO_SEE
    arrays = np.load(export(result, tmp_path / "run.npz", "npz"))
    assert np.array_equal(arrays["colors"][-1], run.colors[-1])
    points = trimesh.load(export(result, tmp_path / "points.ply", "ply", frames=[-1]))
    assert np.array_equal(points.colors[:, :3], run.colors[-1])


@pytest.mark.parametrize("surface", [False, True])
def test_splats_of_each_frame_have_its_colours(result, run, tmp_path, surface):
    """From those of one shape to those of the other, in the sRGB that viewers of splats show."""
    frames = (0, COUNT // 2, COUNT - 1)
    folder = export(result, tmp_path / "all", "splat", frames=frames, surface=surface)
    for snapshot in snapshots(run, surface=surface, frames=frames):
        file = trimesh.load(folder / f"frame-{snapshot.frame:04d}.ply")
        values = file.metadata["_ply_raw"]["vertex"]["data"]
        shares = np.stack([values[f"f_dc_{i}"] for i in range(3)], axis=1) * HARMONIC + 0.5
        np.testing.assert_allclose(255 * shares, snapshot.colors, atol=0.01)


class Glb:
    """A GLB file: its header, and its numbers as they are meant."""

    def __init__(self, path):
        data = path.read_bytes()
        length = int.from_bytes(data[12:16], "little")
        self.header, self.binary = json.loads(data[20 : 20 + length]), data[28 + length :]

    def view(self, index):
        """The bytes of a buffer view."""
        view = self.header["bufferViews"][index]
        return self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]

    def array(self, index):
        """An accessor's values, a row each."""
        accessor = self.header["accessors"][index]
        width = int(accessor["type"].removeprefix("VEC").replace("SCALAR", "1"))
        if "bufferView" not in accessor:
            return np.zeros((accessor["count"], width))
        kind, most = {
            5120: (np.int8, 127), 5121: (np.uint8, 255), 5122: (np.int16, 32767),
            5123: (np.uint16, 65535), 5125: (np.uint32, 1), 5126: (np.float32, 1),
        }[accessor["componentType"]]  # fmt: skip
        stride = self.header["bufferViews"][accessor["bufferView"]].get("byteStride")
        values = np.frombuffer(self.view(accessor["bufferView"]), kind)
        columns = stride // np.dtype(kind).itemsize if stride else width
        return values.reshape(accessor["count"], columns)[:, :width] / most

    def corners(self, node, frame):
        """Where the corners of a node's mesh are in a frame, counted from 0."""
        primitive = self.header["meshes"][node["mesh"]]["primitives"][0]
        places = self.array(primitive["attributes"]["POSITION"])
        if frame:
            places = places + self.array(primitive["targets"][frame - 1]["POSITION"])
        return places * node["scale"][0] + node["translation"]

    def picture(self, node):
        """The texture of a node's mesh, sRGB, shape [height, width, 3]."""
        primitive = self.header["meshes"][node["mesh"]]["primitives"][0]
        surface = self.header["materials"][primitive["material"]]["pbrMetallicRoughness"]
        texture = self.header["textures"][surface["baseColorTexture"]["index"]]
        image = self.header["images"][texture["source"]]
        return np.asarray(Image.open(io.BytesIO(self.view(image["bufferView"]))))


def test_a_moving_mesh_has_colours_that_move(result, egg, tmp_path):
    """GLB: the first colours and the change to the last ones make the original; so does USD."""
    path = export(result, tmp_path / "moving.glb", "glb", tracked=True, frames=[0, 5, COUNT - 1])
    glb = Glb(path)
    (node,) = glb.header["nodes"]
    primitive = glb.header["meshes"][0]["primitives"][0]
    light = glb.array(primitive["attributes"]["COLOR_0"])
    light = light + glb.array(primitive["targets"][-1]["COLOR_0"])
    places = glb.corners(node, 2)
    assert differences(srgb.to_bytes(light), original(egg, places)).max() < STILL_TO_SEE
    assert glb.header["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 1]


@pytest.mark.parametrize("last", [False, True])
def test_a_moving_mesh_has_textures_of_both_ends(result, ball, egg, tmp_path, last):
    """One is on the mesh, one around it, and both are as the originals between corners, too."""
    options = {"tracked": True, "frames": [0, 5, COUNT - 1], "units": "user" if last else "source"}
    glb = Glb(export(result, tmp_path / "moving.glb", "glb", texture=512, **options))
    inner, outer = glb.header["nodes"]
    node, mesh, frame = (outer, egg, 2) if last else (inner, ball, 0)
    primitive = glb.header["meshes"][node["mesh"]]["primitives"][0]
    faces = glb.array(primitive["indices"]).astype(int).reshape(-1, 3)
    picture, uv = glb.picture(node), glb.array(primitive["attributes"]["TEXCOORD_0"])
    assert picture.shape == (512, 512, 3)
    column, row = np.floor(uv[faces].mean(axis=1) * 512).astype(int).T
    centres = glb.corners(node, frame)[faces].mean(axis=1)
    found = differences(picture[row, column], original(mesh, centres))
    # the first frame has gone 2 % of the way already
    assert (found.max() if last else np.median(found)) < STILL_TO_SEE
    around = glb.corners(outer, frame).max(axis=0) - glb.corners(inner, frame).max(axis=0)
    assert 0 < np.linalg.norm(around) < 5e-3 * np.ptp(mesh.bounds, axis=0).max()


def test_the_last_texture_appears_as_the_colours_are_mixed(result, tmp_path):
    """By 3 s^2 - 2 s^3, from clear to opaque: alpha is the weight of the last target."""
    path = export(result, tmp_path / "moving.glb", "glb", texture=64, tracked=True)
    glb = Glb(path)
    (primitive,) = glb.header["meshes"][1]["primitives"]
    assert (glb.array(primitive["attributes"]["COLOR_0"])[:, 3] == 0).all()
    colors = [glb.array(target["COLOR_0"]) for target in primitive["targets"]]
    assert (colors[-1][:, 3] == 1).all()
    assert not np.any(colors[-1][:, :3]) and not np.any(colors[:-1])
    assert not np.any(glb.array(primitive["targets"][-1]["POSITION"]))
    assert glb.header["materials"][primitive["material"]]["alphaMode"] == "BLEND"
    animation = glb.header["animations"][0]
    (channel,) = [one for one in animation["channels"] if one["target"]["node"] == 1]
    weights = glb.array(animation["samplers"][channel["sampler"]]["output"])
    share = (np.arange(COUNT) + 1) / COUNT
    share = 3 * share**2 - 2 * share**3
    expected = (share - share[0]) / (1 - share[0])
    assert weights.reshape(COUNT, -1)[:, -1] == pytest.approx(expected, abs=1e-6)


def test_the_same_texture_twice_is_the_same_file(result, tmp_path):
    """Charts and pictures do not depend on the moment."""
    one, other = (
        export(result, tmp_path / name, "glb", texture=64, tracked=True, frames=[0, -1])
        for name in ("one.glb", "other.glb")
    )
    assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(
    ("format", "options", "cause"),
    [
        ("glb", {"texture": 32, "tracked": True}, "32 pixels is out of range"),
        ("glb", {"texture": 8192, "tracked": True}, "8192 pixels is out of range"),
        ("glb", {"texture": 256}, "tracked surface in a GLB"),
        ("usd", {"texture": 256, "tracked": True}, "tracked surface in a GLB"),
    ],
)
def test_a_texture_that_cannot_be_is_refused(result, tmp_path, format, options, cause):
    """With the cause, before anything is computed."""
    with pytest.raises(ConfigError, match=cause):
        export(result, tmp_path / f"moving.{format}", format, **options)


def test_there_is_no_texture_without_colours(tmp_path):
    """A run of shapes of clay says so."""
    path = tmp_path / "plain.vtkhdf"
    steady(prepare("sphere", "sphere", configure("fast", SETTINGS)), path)
    with pytest.raises(ConfigError, match="have no colours"):
        export(path, tmp_path / "moving.glb", "glb", texture=256, tracked=True)


def test_a_texture_needs_its_extra(result, tmp_path, monkeypatch):
    """Whoever lacks xatlas is told what to install."""
    monkeypatch.setitem(sys.modules, "xatlas", None)
    with pytest.raises(ExtraError, match=r"pip install 'chamfer-morph\[texture\]'"):
        export(result, tmp_path / "moving.glb", "glb", texture=256, tracked=True)


@pytest.mark.parametrize("kind", ["points", "surface", "tracked"])
def test_usd_has_colours_at_each_time(result, egg, tmp_path, kind):
    """As displayColor in linear light, a value at each point, which the bound material reads."""
    pxr = pytest.importorskip("pxr.UsdGeom")
    from pxr import Usd, UsdShade

    options = {} if kind == "points" else {kind: True}
    frames = [0, COUNT - 1]
    path = export(result, tmp_path / "run.usdc", "usd", frames=frames, **options)
    stage = Usd.Stage.Open(str(path))
    (shape,) = [prim for prim in stage.Traverse() if prim.IsA(pxr.PointBased)]
    primvar = pxr.Gprim(shape).GetDisplayColorPrimvar()
    assert primvar.GetInterpolation() == "vertex"
    assert primvar.GetTimeSamples() == [float(frame) for frame in frames]
    points = np.array(pxr.PointBased(shape).GetPointsAttr().Get(COUNT - 1))
    light = np.array(primvar.Get(COUNT - 1))
    assert differences(srgb.to_bytes(light), original(egg, points)).max() < STILL_TO_SEE
    material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial()
    surface = material.ComputeSurfaceSource()[0]
    assert surface.GetShaderId() == "UsdPreviewSurface"
    source = surface.GetInput("diffuseColor").GetConnectedSources()[0][0].source
    reader = UsdShade.Shader(source.GetPrim())
    assert reader.GetShaderId() == "UsdPrimvarReader_float3"
    assert reader.GetInput("varname").Get() == "displayColor"


@pytest.mark.parametrize("surface", [False, True])
def test_pictures_have_the_colours(result, tmp_path, surface):
    """Orange at the left and blue at the right become green and violet."""
    folder = video(result, tmp_path / "film", surface=surface, size=(64, 48), frames=[0, -1])

    def sides(name):
        pixels = np.asarray(Image.open(folder / name).convert("RGB"), float)
        shown = pixels.min(axis=2) < 200
        middle = shown[24].nonzero()[0]
        left, right = middle[len(middle) // 5], middle[-len(middle) // 5]
        return pixels[24, left], pixels[24, right]

    names = sorted(path.name for path in folder.iterdir())
    (red, green, blue), (red_right, _, blue_right) = sides(names[0])
    assert red > green > blue and blue_right > red_right
    (red, green, blue), (red_right, green_right, blue_right) = sides(names[-1])
    assert green > max(red, blue) and min(red_right, blue_right) > green_right


def test_a_shape_without_colours_is_of_clay(ball, tmp_path):
    """And nothing is told, or stored, where no shape has any."""
    path = tmp_path / "run.vtkhdf"
    with Trajectory(steady(prepare(ball, "sphere", configure("fast", SETTINGS)), path)) as run:
        clay = np.rint(255 * np.array(srgb.CLAY))
        assert np.abs(run.colors[1] - clay).max() <= 1
        assert np.array_equal(RunRecord.restore(run.run.document(), run.run.arrays()).stops[0]
                              .colors.textures[0], ball.colors.textures[0])  # fmt: skip
    path = tmp_path / "plain.vtkhdf"
    with Trajectory(steady(prepare("sphere", "sphere", configure("fast", SETTINGS)), path)) as run:
        assert run.colors is None
        assert not [name for name in run.run.arrays() if "colors" in name]
        assert all(one.colors is None for one in snapshots(run, surface=True, frames=(0,)))
        assert b"colors" not in path.read_bytes()


def test_each_leg_leads_from_the_colours_of_the_last_one(ball, egg, tmp_path):
    """A loop ball, egg, ball: its colours pass the egg's and come back, without a jump."""
    record = prepare(ball, [egg, ball], configure("fast", SETTINGS))
    path = steady(record, tmp_path / "loop.vtkhdf", legs=2)
    with pytest.raises(ConfigError, match="these frames span 2 legs"):
        export(path, tmp_path / "loop.glb", "glb", texture=256, tracked=True)
    with Trajectory(path) as run:
        assert run.colors.shape == (3, run.particle_count, 3)
        assert differences(run.colors[0], run.colors[2]).max() < STILL_TO_SEE
        shown = snapshots(run, surface=True, frames=(COUNT - 1, 2 * COUNT - 1))
        for snapshot, mesh in zip(shown, (egg, ball), strict=True):
            found = differences(snapshot.colors, original(mesh, snapshot.vertices))
            assert found.max() < STILL_TO_SEE
        playback = Playback(run, Timing(seconds=2, fps=4, repeat="loop"))
        first, *_, last = Selection(run, (0,), surface=True).played(playback)
        assert np.array_equal(first.colors, last.colors)


@pytest.fixture(scope="module")
def flowing(ball, egg, tmp_path_factory):
    """The ball becomes the egg as it really goes, by the default method."""
    path = tmp_path_factory.mktemp("flow") / "flow.vtkhdf"
    for _ in morph(ball, egg, configure("fast", SETTINGS), out=path):
        pass
    return path


@pytest.mark.parametrize("surface", [False, True])
def test_a_run_begins_and_ends_with_the_colours_of_the_originals(flowing, ball, egg, surface):
    """Wherever its matter has flowed: of a film of two pictures the first is the source itself."""
    with Trajectory(flowing) as run:
        playback = Playback(run, Timing(seconds=1, fps=2))
        played = Selection(run, (0,), surface=surface, units="source").played(playback)
        first = next(iter(played))
        (last,) = snapshots(run, surface=surface, frames=(COUNT - 1,))
    for mesh, snapshot in ((ball, first), (egg, last)):
        found = differences(snapshot.colors, original(mesh, snapshot.vertices))
        assert found.max() < STILL_TO_SEE


def test_matter_that_flows_goes_from_colour_to_colour(flowing):
    """Each particle by 3 s^2 - 2 s^3 of the way in linear light; halfway it is neither of both."""
    with Trajectory(flowing) as run:
        begin, end = srgb.from_bytes(run.colors)
        shown = snapshots(run, surface=False, frames=range(COUNT))
    for frame, snapshot in enumerate(shown):
        s = (frame + 1) / COUNT
        share = 3 * s**2 - 2 * s**3
        mixed = srgb.to_bytes(begin + share * (end - begin))
        assert differences(snapshot.colors, mixed).max() < STILL_TO_SEE
    halfway = shown[COUNT // 2 - 1].colors
    ends = srgb.to_bytes(begin), srgb.to_bytes(end)
    apart = differences(*ends)
    assert np.median(apart) > 10 * STILL_TO_SEE
    for colors in ends:
        assert np.median(differences(halfway, colors) / apart) > 0.25


def test_the_page_is_handed_the_colours_of_a_run(flowing, tmp_path):
    """By particle as well as by corner of the surface: those of an export."""
    for frame in (0, COUNT // 2 - 1, COUNT - 1):
        with Trajectory(flowing) as run:
            (points,) = snapshots(run, surface=False, frames=(frame,))
            (surface,) = snapshots(run, surface=True, frames=(frame,))
        assert np.array_equal(read_colors(flowing).at(frame), points.colors)
        file = tmp_path / f"{frame}.npz"
        reconstruct_surface.run(flowing, frame, file)
        stored = StoredSurface.load(file)
        assert np.array_equal(stored.colors, surface.colors)


@pytest.mark.parametrize("frame", [COUNT // 2 - 1, COUNT - 1])
def test_a_picture_has_the_colours_of_a_run_in_its_light(flowing, tmp_path, frame):
    """At the corners that face the eye, once divided by what grey matter has there."""
    size = (400, 300)
    file = video(flowing, tmp_path / "run.png", surface=True, size=size, frames=[frame])
    drawn = np.asarray(Image.open(file).convert("RGB"), float)
    with Trajectory(flowing) as run:
        (shape,) = snapshots(run, surface=True, frames=(frame,), units="grid")
        seen = np.concatenate([run.positions(frame), run.run.target_points])
        eye = pictures.Camera.facing(seen, pictures.look(up=run.run.placement.up), size)
    grey = pictures.picture(
        shape.vertices, spacing=shape.spacing, colors=np.full(shape.vertices.shape, GREY),
        faces=shape.faces, view=eye, size=size,
    )  # fmt: skip
    facing = shape.normals @ eye.rotation[2] > 0.5
    across, up, _ = eye.seen(shape.vertices[facing], size).T
    pixel = np.floor(size[1] / 2 - up).astype(int), np.floor(size[0] / 2 + across).astype(int)
    flat = drawn[pixel] / (grey[pixel] / 255 / GREY)
    exposed = (drawn[pixel] < 255).all(axis=1)
    found = differences(np.minimum(flat, 255), shape.colors[facing])[exposed]
    assert np.median(found) < STILL_TO_SEE and np.quantile(found, 0.95) < 3 * STILL_TO_SEE
