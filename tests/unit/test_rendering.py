"""Pictures and videos: what is nearer hides what is farther, and files are what they claim."""

import io
import re
import sys
import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import av
import matplotlib
import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_erosion

from morph_engine import srgb
from morph_engine.errors import ConfigError, ExtraError, ResultError
from morph_engine.geometry.surface_reconstruction import reconstruct_surface
from morph_engine.rendering import colormap
from morph_engine.rendering.contact_shadow import DARKEST, Ground
from morph_engine.rendering.materials import MATERIALS, Material, bent, light
from morph_engine.rendering.pictures import Camera, look, picture, thumbnail, video
from morph_engine.rendering.rasterizer import Canvas
from morph_engine.rendering.video_encoder import write_video
from morph_engine.results.trajectory import Trajectory

FRONT = Camera(np.eye(3), np.zeros(3), 5.0)
SMALL = (120, 90)


def ink(image):
    """Which pixels are not white."""
    return (image < 255).any(axis=2)


def test_a_particle_is_a_disc_of_its_size():
    """One particle at the centre covers the area of its sphere, about the centre."""
    image = picture([[0, 0, 0]], spacing=4 / 0.55, view=FRONT, size=(200, 200))
    seen = ink(image)
    assert image.shape == (200, 200, 3) and image.dtype == np.uint8
    assert seen.sum() == pytest.approx(np.pi * 80**2, rel=0.03)  # 4 dx at 20 pixels each
    rows, columns = np.nonzero(seen)
    assert rows.mean() == pytest.approx(99.5, abs=0.5)
    assert columns.mean() == pytest.approx(99.5, abs=0.5)
    upper_left, lower_right = image[60, 60].sum(), image[140, 140].sum()
    assert upper_left > lower_right  # where the light comes from


def test_the_nearer_particle_is_seen():
    """Red before blue shows no blue in the middle, in whatever order they come."""
    points, colors = np.array([[0, 0, 2.0], [0, 0, -2.0]]), np.eye(3)[[0, 2]]
    for order in ([0, 1], [1, 0]):
        image = picture(points[order], spacing=2, colors=colors[order], view=FRONT, size=(90, 90))
        red, _, blue = image[45, 45]
        assert red > 100 and blue == 0


def test_what_is_left_out_is_hidden(lattice_ball, monkeypatch):
    """Dropping the particles behind others leaves every pixel as it is."""
    ball = lattice_ball(3.0, 0.4)
    colors = np.random.default_rng(1).random(ball.shape)
    quick = picture(ball, spacing=0.4, colors=colors, size=SMALL)
    dropped = []

    def all_of_them(canvas, centres, radius):
        dropped.append(len(centres) - len(in_sight(canvas, centres, radius)))
        return np.arange(len(centres))

    in_sight = Canvas._in_sight
    monkeypatch.setattr(Canvas, "_in_sight", all_of_them)
    np.testing.assert_array_equal(quick, picture(ball, spacing=0.4, colors=colors, size=SMALL))
    assert dropped[0] > len(ball) / 3


def test_surface_and_particles_have_the_same_outline(lattice_ball):
    """A ball drawn either way covers the same pixels, but for a rim."""
    ball = lattice_ball(4.0, 0.4)
    found = reconstruct_surface(ball, 0.4)
    view = Camera.facing(ball, look(), SMALL)
    particles = ink(picture(ball, spacing=0.4, view=view, size=SMALL))
    triangles = ink(picture(found.vertices, spacing=0.4, faces=found.faces, view=view, size=SMALL))
    assert (particles & triangles).sum() / (particles | triangles).sum() > 0.93


def test_smooth_particles_are_lit_as_their_surface_is(lattice_ball):
    """A ball's particles are shaded nearly as its surface, not as so many beads."""
    ball = lattice_ball(4.0, 0.4)
    found = reconstruct_surface(ball, 0.4)
    shown = {"view": Camera.facing(ball, look(), SMALL), "size": SMALL, "spacing": 0.4}
    surface = picture(found.vertices, faces=found.faces, **shown).astype(float)
    within = binary_erosion(ink(surface), iterations=5)

    def levels_off(**how):
        return np.abs(picture(ball, **shown, **how) - surface)[within].mean()

    assert levels_off(smooth=True) < levels_off() / 4


def test_smoothing_keeps_what_lies_behind_apart():
    """A plate before another keeps its edge: both are lit as each is alone."""
    lines = np.arange(-3, 3.2, 0.2)
    plate = np.stack(np.meshgrid(lines, lines, [0.0]), axis=-1).reshape(-1, 3)
    near = plate[plate[:, 0] > 0] + [0, 0, 4.0]
    together = np.concatenate([plate, near])
    canvases = []
    for points in (near, together):
        canvas = Canvas(*SMALL)
        canvas.spheres((10 * points).astype(np.float32), 2.0, np.zeros_like(points, np.float32))
        canvas.smooth(6, 6.0)
        canvases.append(canvas)
    alone, both = canvases
    np.testing.assert_array_equal(alone.depth[alone.covered], both.depth[alone.covered])


def test_a_turntable_keeps_everything_in_the_picture(lattice_ball):
    """From every side a long shape stays clear of the picture's edge, and nearly fills it."""
    points = lattice_ball(3.0, 0.6) * np.array([1.0, 1.0, 3.0])
    camera = Camera.around(points, look(), SMALL)
    widths = []
    for azimuth in range(0, 180, 30):
        view = replace(camera, rotation=look(azimuth=azimuth))
        seen = ink(picture(points, spacing=0.6, view=view, size=SMALL))
        assert not (seen[[0, -1]].any() or seen[:, [0, -1]].any())
        widths.append(np.ptp(np.flatnonzero(seen.any(axis=0))))
    assert max(widths) > 0.8 * SMALL[0]


def test_thumbnail_is_a_small_transparent_picture(lattice_ball):
    """240 x 180, the shape in the middle, nothing in the corners, lost particles no trouble."""
    points = np.concatenate([lattice_ball(3.0, 0.5), [[np.nan, 0, 0]]])
    image = np.asarray(Image.open(io.BytesIO(thumbnail(points, 0.5))))
    assert image.shape == (180, 240, 4)
    assert image[90, 120, 3] == 255
    assert not image[[0, 0, -1, -1], [0, -1, 0, -1], 3].any()


@pytest.mark.parametrize(
    "points",
    [np.zeros((1, 3)), np.full((500, 3), 7.0), [[0, 0, 0], [0.001, 0, 0]]],
    ids=["one", "equal", "close"],
)
@pytest.mark.parametrize("spacing", [1.0, 1e-3])
def test_what_has_collapsed_is_shown_as_a_sphere(points, spacing):
    """Particles in one place are a sphere of a particle's size, in the middle of the picture."""
    points = np.asarray(points) * spacing
    seen = ink(picture(points, spacing=spacing, size=(240, 180)))
    radius = 0.55 * 180 / (2 * 1.06)
    assert seen.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    assert seen[90, 120]
    cover = np.asarray(Image.open(io.BytesIO(thumbnail(points, spacing))))[..., 3]
    assert (cover == 255).sum() > 0.9 * np.pi * radius**2
    assert cover[90, 120] == 255


def test_large_spheres_are_drawn_as_small_ones_are(lattice_ball):
    """Some particles look the same however large they are in pixels."""
    points = lattice_ball(1.2, 0.8)
    colors = np.random.default_rng(1).random(points.shape)
    small, large = (
        picture(points, spacing=0.8, colors=colors, size=(edge, edge), background=None)
        for edge in (120, 480)
    )
    coarse = large.reshape(120, 4, 120, 4, 4).mean(axis=(1, 3))
    assert np.abs(coarse - small).mean() < 3


@pytest.mark.parametrize("up", ["y", "z"])
def test_light_comes_from_above_however_steep_the_view(lattice_ball, up):
    """Between two views that hardly differ, nothing changes at once."""
    ball = reconstruct_surface(lattice_ball(3.0, 0.5), 0.5)
    steep, steeper = (
        picture(
            ball.vertices, faces=ball.faces, spacing=0.5, size=SMALL, material="porcelain",
            view=Camera(look(azimuth=0, elevation=elevation, up=up), np.zeros(3), 5.0, up),
        )
        for elevation in (44.5, 45.5)
    )  # fmt: skip
    assert np.abs(steep.astype(float) - steeper).mean() < 2


@pytest.mark.parametrize("shape", ["particles", "surface"])
def test_a_shape_casts_a_soft_shadow_where_it_touches_the_ground(lattice_ball, shape):
    """Darkest below the lower of two balls, never beyond the bound, gone at the picture's edge."""
    foot, head = np.array([2.0, -2.5, 1.0]), np.array([0, 1.5, 0])
    ball = np.concatenate([lattice_ball(2.0, 0.25) + head, lattice_ball(1.0, 0.25) + foot])
    faces = None
    if shape == "surface":
        surface = reconstruct_surface(ball, 0.25)
        ball, faces = surface.vertices, surface.faces
    ground = Ground.below(ball, "y")
    camera = Camera(look(elevation=30), np.zeros(3), 9.0)
    drawn = {
        on: picture(ball, spacing=0.25, faces=faces, view=camera, size=(180, 180), ground=on)
        for on in (None, ground)
    }
    bare = ~ink(drawn[None])
    inner = binary_erosion(~bare, iterations=2)  # at its edge both are seen
    np.testing.assert_array_equal(drawn[None][inner], drawn[ground][inner])
    seen = ground.seen(
        ground.shadow(ball, 0.55 * 0.25, faces), camera.rotation, camera.centre, 0.1, (180, 180)
    )
    right, down = camera.rotation[:2] @ [foot[0], ground.level, foot[2]] * [10, -10] + 89.5
    darkest = np.argwhere(seen > 0.9 * seen.max()).mean(axis=0)
    assert darkest == pytest.approx((down, right), abs=2)
    assert 0.5 * DARKEST < seen.max() <= DARKEST
    assert not seen[:, [0, -1]].any() and not seen[[0, -1]].any()
    grey = drawn[ground][bare][:, 0] / 255
    assert grey == pytest.approx(1 - seen[bare], abs=0.005)


def test_a_shadow_needs_an_eye_above_the_ground(lattice_ball):
    """From below nothing is in the way of the shape."""
    ball = lattice_ball(3.0, 0.5)
    ground, below = Ground.below(ball, "y"), Camera(look(elevation=-20), np.zeros(3), 6.0)
    with_ground, without = (
        picture(ball, spacing=0.5, view=below, size=SMALL, ground=on) for on in (ground, None)
    )
    np.testing.assert_array_equal(with_ground, without)


def test_a_shadow_is_the_same_whichever_axis_is_up(lattice_ball):
    """y and z upwards give one picture, and on a transparent background the shadow is cover."""
    y_up = lattice_ball(3.0, 0.5) * [1.0, 0.6, 1.4]
    pictures = [
        picture(
            points, spacing=0.5, size=SMALL, background=None, material="clay",
            view=Camera(look(up=up), np.zeros(3), 8.0), ground=Ground.below(points, up),
        )
        for points, up in ((y_up, "y"), (y_up[:, [0, 2, 1]] * [1, -1, 1], "z"))
    ]  # fmt: skip
    apart = np.abs(pictures[0].astype(int) - pictures[1])
    assert apart.mean() < 0.2  # levels of 255; particles on edges fall to either side
    cover = pictures[0][..., 3]
    black = pictures[0][..., :3].max(axis=2) == 0
    assert (black & (cover > 20)).sum() > 50
    assert cover[black].max() <= 255 * DARKEST


def test_pictures_in_a_look_stand_on_a_ground(small_result, tmp_path):
    """`morph render --look` has the page's shadow, all of it in the picture; else there is none."""
    for look_name, shadow in ((None, False), ("clay", True)):
        path = video(small_result, tmp_path / f"{look_name}.png", material=look_name, surface=True)
        image = np.asarray(Image.open(path).convert("RGB"), int)
        grey = (np.ptp(image, axis=2) == 0) & (image[..., 0] < 235) & (image[..., 0] > 120)
        below = grey[image.shape[0] * 3 // 4 :]
        assert (below.sum() > 500) == shadow
        assert not grey[-1].any()


def test_the_body_touches_the_ground_in_every_frame(lattice_ball, small_result):
    """Films that end higher or lower than they begin: the shadow goes along, and none hovers."""
    ball = lattice_ball(2.0, 0.25)
    ground = Ground.below(ball, "z")
    for height in (-3.0, 0.0, 3.0):
        there = ball + np.array([0, 0, height])
        assert ground.touched_by(there).level == there[:, 2].min()
    with Trajectory(small_result) as result:
        least = [result.positions(index)[:, 1].min() for index in range(result.frame_count)]
    levels = []
    drawn = Ground.shadow

    def watched(ground, *arguments):
        levels.append(ground.level)
        return drawn(ground, *arguments)

    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        patch.setattr(Ground, "shadow", watched)
        video(small_result, Path(folder) / "film.zip", material="clay", size=SMALL)
    assert levels == pytest.approx(least)
    assert np.ptp(least) > 0


VIEWER_JS = Path(__file__).resolve().parents[2] / "server/web/src/viewer"
LOOKS_JS = VIEWER_JS / "looks.js"


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_page_looks_from_the_same_sides(up):
    """Front, right and top are those of its keys 1, 3 and 7; at first both look from one corner."""
    text = (VIEWER_JS / "viewpoint.js").read_text()
    numbers = r"\[([-\d., ]+)\]"

    def page(pattern):
        found = re.search(pattern + r"\{[^}]*\b" + up + ": " + numbers, text)
        return np.array([float(number) for number in found[1].split(",")])

    for key, place in ((1, (0, 0)), (3, (90, 0)), (7, (0, 90))):
        azimuth, elevation = place
        toward = look(azimuth=azimuth, elevation=elevation, up=up)[2]
        assert toward == pytest.approx(page(rf"SIDES = .*\b{key}: "), abs=1e-12)
    first = page("FROM = ")
    cosine = look(up=up)[2] @ first / np.linalg.norm(first)
    assert np.degrees(np.arccos(cosine)) < 4  # 25 and 15 degrees here, 27 and 17 there


def test_the_page_has_the_same_looks():
    """Names, colours, roughness, clear layers, and what passes through."""
    text = LOOKS_JS.read_text()
    page = dict(re.findall(r"^  (\w+): \{(.*?)\},?$", text, re.M | re.S))
    assert page.keys() == MATERIALS.keys()
    for name, material in MATERIALS.items():
        assert re.search(rf'color: "{material.color}"', page[name])
        usual = Material("#000000", 0.0)
        for key in ("roughness", "metalness", "clearcoat", "transmission", "ior", "thickness"):
            found = re.search(rf"\b{key}: ([\d.]+)", page[name])
            value = float(found[1]) if found else getattr(usual, key)
            assert getattr(material, key) == value


def test_light_that_passes_through_is_bent_and_tinted():
    """Not where one looks straight at glass, and towards its middle at its rim (Snell's law)."""
    glass = MATERIALS["glass"]
    sine = 0.8
    normals = np.array([[0.0, 0.0, 1.0], [sine, 0.0, 0.6]])
    straight, aside = bent(glass, normals)
    assert straight == pytest.approx([0, 0])
    inside = np.arcsin(sine / glass.ior)
    assert aside == pytest.approx([-glass.thickness * np.sin(np.arcsin(sine) - inside), 0])
    behind = np.array([[0.2, 0.4, 0.1, 1.0], [0.2, 0.4, 0.1, 1.0]])
    tint = srgb.linear(np.array([0.0, 0.5, 1.0]))
    openness, eye = np.zeros(2), np.eye(3)
    colors = np.array([[0.0, 0.5, 1.0]] * 2)
    passed = light(glass, normals, openness, eye, behind, colors)
    dark = light(glass, normals, openness, eye, np.zeros((2, 4)), colors)
    assert passed[:, 3] == pytest.approx(1)
    assert dark[:, 3] == pytest.approx(1 - tint.mean())
    reflected = 1 - (passed - dark)[0, 1:3] / (tint * behind[0, :3])[1:]
    assert reflected == pytest.approx(glass.reflectance, abs=0.01)


def test_looks_are_told_apart(lattice_ball):
    """Metal shines and is dark elsewhere, clay does neither, glass shows what is behind."""
    surface = reconstruct_surface(lattice_ball(3.0, 0.5), 0.5)

    def seen(material, **more):
        image = picture(
            surface.vertices,
            spacing=0.5,
            faces=surface.faces,
            size=SMALL,
            material=material,
            **more,
        )
        return image[20:70, 35:85].astype(float)

    contrast = {name: seen(name).mean(axis=2).std() for name in MATERIALS}
    assert contrast["metal"] > 2 * contrast["clay"]
    assert contrast["metal"] > 2 * contrast["porcelain"]
    red, green, blue = seen("jelly").mean(axis=(0, 1))
    assert red > 1.5 * max(green, blue)
    behind = {
        name: seen(name, background=(0, 0, 1)).mean(axis=(0, 1)) for name in ("clay", "glass")
    }
    assert behind["clay"] == pytest.approx(seen("clay").mean(axis=(0, 1)), abs=3)
    assert behind["glass"][2] > behind["glass"][0] + 30
    transparent = seen("glass", background=None)
    assert transparent[..., 3].mean() < 200


def test_own_colours_keep_their_hue_in_a_look(lattice_ball):
    """Blue matter is blue porcelain."""
    points = lattice_ball(3.0, 0.5)
    blue = np.tile([0.1, 0.2, 0.9], (len(points), 1))
    image = picture(points, spacing=0.5, colors=blue, size=SMALL, material="porcelain")
    middle = image[30:60, 45:75].reshape(-1, 3).mean(axis=0)
    assert middle[2] > 1.5 * middle[0]


def test_mp4_holds_every_frame_and_a_rest(small_result, tmp_path):
    """H.264 of the size asked for: three frames, then a second of the last one."""
    path = video(small_result, tmp_path / "egg.mp4", field="det_f", size=SMALL, fps=4)
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        assert stream.codec_context.name == "h264"
        pictures = [frame.to_ndarray(format="rgb24") for frame in file.decode(stream)]
    assert len(pictures) == 3 + 4
    assert pictures[0].shape == (90, 120, 3)
    change = [np.abs(a.astype(int) - b).mean() for a, b in pairwise(pictures)]
    assert min(change[:2]) > 10 * max(change[3:])


@pytest.mark.parametrize("kind", ["mp4", "webm"])
def test_a_video_says_how_its_colours_are_stored(tmp_path, kind):
    """As HD video (BT.709): luma and chroma of the standard's formula, from 16 to 235 and 240."""
    red, green, blue = 189, 129, 99
    path = tmp_path / f"plain.{kind}"
    pictures = [np.full((64, 64, 3), (red, green, blue), np.uint8)] * 3
    write_video(path, pictures, kind=kind, fps=10)
    luma = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    expected = (
        16 + 219 * luma / 255,
        128 + 224 * (blue - luma) / 1.8556 / 255,
        128 + 224 * (red - luma) / 1.5748 / 255,
    )
    with av.open(str(path)) as file:
        frame = next(file.decode(video=0))
        context = file.streams.video[0].codec_context
        assert (context.colorspace, context.color_primaries, context.color_trc) == (1, 1, 1)
        assert context.color_range == 1
        stored = [bytes(plane)[10 * plane.line_size + 10] for plane in frame.planes]
    np.testing.assert_allclose(stored, expected, atol=1.5)  # rounded, and compressed


def test_a_gif_that_browsers_would_slow_down_is_refused(small_result, tmp_path):
    """They show a frame of 10 ms for 100."""
    with pytest.raises(ConfigError, match="50 frames per second"):
        video(small_result, tmp_path / "egg.gif", size=SMALL, fps=60)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("fps", [0, -12, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(small_result, tmp_path, fps):
    """Before anything is drawn, whatever the kind."""
    for name in ("egg.gif", "egg.mp4", "pictures"):
        with pytest.raises(ConfigError, match="frames per second is out of range"):
            video(small_result, tmp_path / name, size=SMALL, fps=fps)
    assert not list(tmp_path.iterdir())


def test_frames_of_a_video_are_one_or_several(small_result, tmp_path):
    """A single one needs no list, and none is refused."""
    alone = video(small_result, tmp_path / "a.gif", frames=1, size=SMALL)
    listed = video(small_result, tmp_path / "b.gif", frames=[1], size=SMALL)
    assert alone.read_bytes() == listed.read_bytes()
    with pytest.raises(ConfigError, match="No frame"):
        video(small_result, tmp_path / "c.gif", frames=[], size=SMALL)


def test_gif_turns_the_surface(small_result, tmp_path):
    """Two frames from two sides, the last one resting for a second: three seconds in all."""
    path = video(
        small_result,
        tmp_path / "egg.gif",
        surface=True,
        turntable=True,
        frames=[0, 2],
        size=SMALL,
        fps=1,
    )
    with Image.open(path) as image:
        assert image.size == SMALL
        durations, pictures = [], []
        for index in range(image.n_frames):
            image.seek(index)
            durations.append(image.info["duration"])
            pictures.append(np.asarray(image.convert("RGB")))
    assert sum(durations) == 3000
    assert ink(pictures[0]).sum() == pytest.approx(ink(pictures[-1]).sum(), rel=0.3)
    assert (pictures[0] != pictures[-1]).any()


def test_a_picture_holds_one_frame(small_result, tmp_path):
    """The last one unless another is named; more than one is refused."""
    size = (64, 48)
    last = video(small_result, tmp_path / "last.png", size=size)
    named = video(small_result, tmp_path / "named.png", size=size, frames=[-1])
    first = video(small_result, tmp_path / "first.png", size=size, frames=[0])
    assert last.read_bytes() == named.read_bytes() != first.read_bytes()
    with Image.open(last) as picture:
        assert (picture.format, picture.size) == ("PNG", size)
    with pytest.raises(ConfigError, match="one picture"):
        video(small_result, tmp_path / "two.png", frames=[0, 1])


def test_refusals_name_cause_and_remedy(small_result, tmp_path, monkeypatch):
    """Odd sizes, other endings and a missing package are told before anything is written."""
    with pytest.raises(ConfigError, match="even numbers"):
        video(small_result, tmp_path / "a.mp4", size=(121, 90))
    with pytest.raises(ConfigError, match=r"\.mov or \.gif"):
        video(small_result, tmp_path / "a.avi")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ExtraError, match=r"pip install 'chamfer-morph\[video\]'"):
        video(small_result, tmp_path / "a.mp4", size=SMALL)
    assert not list(tmp_path.iterdir())


def test_a_video_is_there_as_a_whole_or_not_at_all(small_result, tmp_path, monkeypatch):
    """What breaks off leaves the older video, and says why."""
    path = tmp_path / "egg.gif"
    path.write_bytes(b"the older one")

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("morph_engine.rendering.pictures.write_video", full)
    with pytest.raises(ResultError, match="No space left"):
        video(small_result, path, size=SMALL)
    assert path.read_bytes() == b"the older one"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ResultError, match="Cannot write"):
        video(small_result, tmp_path / "no" / "folder.gif", size=SMALL)


@pytest.mark.parametrize("palette", ["viridis", "coolwarm", "turbo", "plasma"])
def test_palettes_are_those_of_matplotlib(palette):
    """Pictures and figures have the same colours; Matplotlib itself is not needed for pictures."""
    values = np.linspace(0, 1, 1001)
    expected = matplotlib.colormaps[palette](values)[:, :3]
    np.testing.assert_allclose(colormap.colors(values, 0, 1, palette=palette), expected, atol=1e-12)
