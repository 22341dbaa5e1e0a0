"""Animated GLB files in Blender: they play there as they were computed, and are rendered."""

from __future__ import annotations

import numpy as np
import pytest

from tests.animated_pair import FPS, FRAMES, PAIRS, AnimatedPair
from tests.blender.in_blender import covered, found_in_blender

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module", params=PAIRS)
def moving(request, tmp_path_factory):
    """A pair as an animated GLB."""
    return AnimatedPair.computed(request.param, tmp_path_factory.mktemp("pair"))


@pytest.fixture(scope="module")
def found(moving):
    """What `play_animated_glb.py` has found in Blender."""
    return found_in_blender(
        "play_animated_glb.py", moving.path, FPS, FRAMES, folder=moving.path.parent
    )


def test_one_mesh_at_a_time_moves_by_shape_keys(found, moving):
    """Two where the topology changes; a key per frame, the one without a change included."""
    assert len(found["meshes"]) == (2 if moving.changes else 1)
    assert found["keys"] == [len(mesh.frames) for mesh in moving.surface.meshes]
    assert all(len(frame) == 1 for frame in found["frames"])


def test_vertices_stay_and_are_where_they_belong(found, moving):
    """As many in every frame of a mesh as were exported, in the same order, z up."""
    for frame, (mesh,) in enumerate(found["frames"]):
        expected = moving.shown(frame)
        assert mesh["triangles"] == len(expected.faces)
        x, y, z = expected.vertices[expected.frames.index(frame)].T
        # a position has 16 bits, and the shapes are some 10 wide
        np.testing.assert_allclose(mesh["corners"], np.stack([x, -z, y], axis=1), atol=1e-3)


def test_it_is_rendered(found, moving):
    """The shape is in the picture of the first, the middle and the last frame, each another one."""
    pictures = [covered(moving.path.parent / name) for name in found["pictures"]]
    for shape in pictures:
        assert 0.02 < shape.mean() < 0.9
    for one, other in ((0, 1), (1, 2), (0, 2)):
        assert (pictures[one] != pictures[other]).mean() > 0.01
