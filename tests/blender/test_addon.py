"""The Blender add-on in Blender, against the real service."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.blender.in_blender import covered, found_in_blender
from tests.live_service import LiveService, free_port

pytestmark = pytest.mark.blender

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service with nothing in it."""
    service = LiveService(tmp_path_factory.mktemp("service"), free_port())
    service.start()
    yield service
    service.stop()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where Blender works."""
    return tmp_path_factory.mktemp("blender")


@pytest.fixture(scope="module")
def extension():
    """The zip that `make addon` has written."""
    return Path(os.environ["MORPH_ADDON"])


@pytest.fixture(scope="module")
def found(extension, service, folder):
    """What `drive_addon.py` has found in Blender."""
    return found_in_blender("drive_addon.py", extension, service.url, folder=folder)


def test_the_extension_is_valid(extension, tmp_path):
    """Blender's own check has nothing against it, and it is what the folder has now."""
    (tmp_path / "broken.zip").write_bytes(b"none")
    zips = {extension: 0, tmp_path / "broken.zip": 1}
    for path, status in zips.items():
        found = found_in_blender("validate_addon.py", path, folder=tmp_path)
        assert found["status"] == status
    sources = [*(ROOT / "blender").glob("*.py"), ROOT / "blender" / "blender_manifest.toml"]
    with zipfile.ZipFile(extension) as file:
        packed = {name: file.read(name) for name in file.namelist()}
    assert packed == {path.name: path.read_bytes() for path in sources}


def test_two_objects_become_one_that_moves(found):
    """Half a second at 24 frames per second, of one mesh; the originals are hidden."""
    assert found["outcome"] == ["FINISHED"]
    assert found["frames"] == [0, 11]
    assert found["hidden"] == [True, True]
    assert found["vertices"] > 1000


def test_it_ends_where_the_target_is(found):
    """In the scene's own coordinates, with the target's rotation and modifier.

    Particles are .1 apart, and the tip of the cone is thinner.
    """
    shapes = np.array(found["shapes"])
    np.testing.assert_allclose(shapes[-1], found["cone"], atol=0.2)
    steps = np.abs(np.diff(shapes, axis=0)).max(axis=(1, 2))
    assert steps.sum() > 0.5 and steps.max() < 0.5


def test_it_is_rendered(found, folder):
    """The object is in the picture at both ends, and another one."""
    first, last = (covered(folder / name) for name in found["pictures"])
    assert first.mean() > 0.005 and last.mean() > 0.005 and (first != last).any()


def test_what_is_missing_is_told(found):
    """The button waits for a target; without a service the message says how to start one."""
    assert found["without target"] is False
    assert "No morph service answers at http://127.0.0.1:9" in found["without service"]
    assert "morph serve" in found["without service"]


def test_the_button_leaves_the_window_usable(found):
    """It returns at once, waits for its morph, and passes on what is not its own."""
    assert found["pressed"] == ["RUNNING_MODAL"]
    assert found["again meanwhile"] is False
    assert found["mouse"] == ["PASS_THROUGH"]


def test_it_ends_as_it_began(found):
    """Whatever is chosen meanwhile is of the next morph: the source is hidden, as it was to be."""
    assert found["chosen meanwhile"] == [["FINISHED"], True]


def test_it_can_be_stopped(found):
    """By its own button, which waits for a morph again afterwards."""
    ended, ticks = found["stopped"]
    assert ended == ["FINISHED"] and ticks[-1] == ["CANCELLED"]
    assert found["stop again"] is False
