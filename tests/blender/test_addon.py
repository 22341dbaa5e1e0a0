"""The Blender add-on in Blender, against the real service."""

from __future__ import annotations

import json
import os
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.live_service import LiveService, free_port

pytestmark = pytest.mark.blender

ROOT = Path(__file__).resolve().parents[2]
ADDON = ROOT / "blender"
DRIVER = Path(__file__).with_name("drive_addon.py")


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service with nothing in it."""
    service = LiveService(tmp_path_factory.mktemp("service"), free_port())
    service.start()
    yield service
    service.stop()


@pytest.fixture(scope="module")
def found(service, tmp_path_factory):
    """What `drive_addon.py` has found in Blender."""
    folder = tmp_path_factory.mktemp("blender")
    extension = folder / "chamfer_morph.zip"
    with zipfile.ZipFile(extension, "w") as file:
        for path in (*ADDON.glob("*.py"), ADDON / "blender_manifest.toml"):
            file.write(path, path.name)
    outcome = subprocess.run(
        [os.environ["MORPH_BLENDER"], DRIVER, extension, service.url],
        env=os.environ | {"BLENDER_USER_RESOURCES": str(folder)},
        cwd=folder, capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    lines = [line for line in outcome.stdout.splitlines() if line.startswith("FOUND ")]
    assert lines, outcome.stdout[-2000:] + outcome.stderr[-2000:]
    return json.loads(lines[0].removeprefix("FOUND "))


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


def test_it_is_rendered(found):
    """The object is in the picture at both ends, and another one."""
    first, last = found["pictures"]
    assert first > 0.005 and last > 0.005 and first != last


def test_what_is_missing_is_told(found):
    """The button waits for a target; without a service the message says how to start one."""
    assert found["without target"] is False
    assert "No morph service answers at http://127.0.0.1:9" in found["without service"]
    assert "morph serve" in found["without service"]
