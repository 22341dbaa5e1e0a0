"""Gaussian splats as shapes: what encloses a solid becomes one, what does not is refused."""

import numpy as np
import pytest

from morph_engine.errors import MeshError
from morph_engine.export.splat import PROPERTIES
from morph_engine.geometry.mesh import load_mesh

RADIUS = 3.0
CENTRE = np.array([10.0, -5.0, 2.0])


def directions(count):
    """Points spread evenly over the unit sphere (a Fibonacci lattice), shape [count, 3]."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def splat_file(path, places, *, sigma=0.05, color=(0.5, 0.5, 0.5), opacity=4.0, **changed):
    """A file of round splats; returns its path."""
    values = dict.fromkeys(PROPERTIES, 0.0)
    values |= dict(zip("xyz", places.T, strict=True))
    values |= {f"scale_{i}": np.log(sigma) for i in range(3)}
    values |= {f"f_dc_{i}": (share - 0.5) * 2 * np.sqrt(np.pi) for i, share in enumerate(color)}
    values |= {"rot_0": 1.0, "opacity": opacity} | changed
    table = np.stack([np.broadcast_to(values[name], len(places)) for name in PROPERTIES], axis=1)
    header = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {len(places)}\n"
    header += "".join(f"property float {name}\n" for name in PROPERTIES) + "end_header\n"
    path.write_bytes(header.encode() + table.astype("<f4").tobytes())
    return path


def test_shell_becomes_a_ball(tmp_path):
    """Splats on a sphere, as in a capture: one closed surface, volume to 6 %, its colour."""
    red = (0.9, 0.1, 0.2)
    path = splat_file(tmp_path / "shell.ply", CENTRE + RADIUS * directions(8000), color=red)
    mesh = load_mesh(path)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.06)
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 2
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), CENTRE, atol=0.02)
    assert np.abs(mesh.colors.corners - np.multiply(red, 255)).max() <= 1
    assert "splats" in mesh.repairs[0]


def test_filled_body_stays_full(tmp_path):
    """Splats throughout a cube, half a spacing wide: no cavity, a surface as far beyond them."""
    axis = np.linspace(-1, 1, 24)
    places = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    step = axis[1] - axis[0]
    mesh = load_mesh(splat_file(tmp_path / "cube.ply", places, sigma=step / 2))
    assert mesh.volume == pytest.approx((2 + step / 2) ** 3, rel=0.05)
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 2


def test_haze_and_strays_take_no_part(tmp_path):
    """Faint splats, distant ones and broken ones leave the surface where it is."""
    shell = RADIUS * directions(8000)
    alone = load_mesh(splat_file(tmp_path / "alone.ply", shell))
    haze = np.random.default_rng(0).uniform(-2 * RADIUS, 2 * RADIUS, (500, 3))
    far = np.array([[40.0, 0, 0], [0, -70, 0], [np.nan, 0, 0]])
    opacity = np.concatenate([np.full(8000, 4.0), np.full(500, -5.0), np.full(3, 4.0)])
    places = np.concatenate([shell, haze, far])
    among = load_mesh(splat_file(tmp_path / "among.ply", places, opacity=opacity))
    np.testing.assert_array_equal(among.vertices, alone.vertices)


@pytest.mark.parametrize(
    ("places", "options", "words"),
    [
        (directions(8000)[:4000], {"sigma": 0.005}, "no solid"),  # half a shell
        (directions(8000), {"opacity": -9.0}, "opaque"),
        (np.zeros((10, 3)), {}, "opaque"),
        (directions(8000), {"scale_0": np.nan}, "opaque"),
    ],
)
def test_what_encloses_nothing_is_refused(tmp_path, places, options, words):
    """With the cause, and what to do about it."""
    with pytest.raises(MeshError, match=words) as refused:
        load_mesh(splat_file(tmp_path / "bad.ply", places, **options))
    assert refused.value.remedy


def test_rotation_without_length_is_none(tmp_path):
    """A quaternion of zeros, which some programs write, counts as no turn."""
    mesh = load_mesh(splat_file(tmp_path / "q.ply", RADIUS * directions(8000), rot_0=0.0))
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.06)
