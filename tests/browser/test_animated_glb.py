"""Animated GLB files: the Khronos validator finds nothing, and three.js plays them."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.animated_pair import FPS, FRAMES, PAIRS, AnimatedPair
from tests.patience import patient

pytestmark = pytest.mark.browser

MODULES = Path(__file__).resolve().parents[2] / "server" / "web" / "node_modules"
SITE = "http://gltf.test/"

VALIDATE = """
const validator = require(process.argv[1]);
validator.validateBytes(new Uint8Array(require("fs").readFileSync(process.argv[2])))
  .then((report) => console.log(JSON.stringify(report.issues)));
"""

PAGE = """<!doctype html><style>body { margin: 0 }</style><script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}
</script><script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
const gltf = await new GLTFLoader().loadAsync("/file.glb");
const scene = new THREE.Scene();
scene.add(gltf.scene, new THREE.HemisphereLight(0xffffff, 0x444444, 3));
const mixer = new THREE.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[0]);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(200, 200);
document.body.append(renderer.domElement);
window.shown = (seconds) => {
  mixer.setTime(seconds);
  gltf.scene.updateMatrixWorld(true);
  const meshes = [];
  gltf.scene.traverse((mesh) => {
    if (!mesh.isMesh || mesh.scale.x === 0) return;
    const corners = [], corner = new THREE.Vector3();
    for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
      corners.push(mesh.getVertexPosition(i, corner).applyMatrix4(mesh.matrixWorld).toArray());
    }
    meshes.push({ name: mesh.name, corners, roughness: mesh.material.roughness });
  });
  const box = new THREE.Box3();
  for (const { corners } of meshes) for (const one of corners) box.expandByPoint(new THREE.Vector3(...one));
  const ball = box.getBoundingSphere(new THREE.Sphere());
  const camera = new THREE.PerspectiveCamera(40, 1, ball.radius / 100, 100 * ball.radius);
  camera.position.copy(ball.center).add(new THREE.Vector3(0, 0, 3.5 * ball.radius));
  renderer.render(scene, camera);
  return { duration: gltf.animations[0].duration, meshes };
};
window.ready = true;
</script>"""  # noqa: E501


@pytest.fixture(scope="module", params=PAIRS)
def moving(request, tmp_path_factory):
    """A pair as an animated GLB."""
    return AnimatedPair.computed(request.param, tmp_path_factory.mktemp("pair"))


def test_the_khronos_validator_finds_nothing(moving):
    """No error, no warning, not even a hint."""
    issues = validated(moving.path)
    assert issues["messages"] == []
    assert issues["numErrors"] == 0


def validated(path):
    """What the validator finds in a file."""
    node = shutil.which("node")
    if node is None:
        pytest.fail("There is no node. Run `make test-browser`.")
    printed = subprocess.run(
        [node, "-e", VALIDATE, MODULES / "gltf-validator", path],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    return json.loads(printed)


def test_three_plays_it(moving, browser):
    """Every frame is where the user's files have it, by one mesh at a time, and can be seen."""
    assert (moving.surface.changes_at is not None) == moving.changes
    with playing(browser, moving.path) as page:
        _check_frames(page, moving)


def _check_frames(page, moving):
    for frame in range(FRAMES):
        # the second mesh is there from its first moment on
        shown = page.evaluate(f"shown({frame / FPS + 1e-4})")
        assert shown["duration"] == pytest.approx((FRAMES - 1) / FPS)
        (mesh,) = shown["meshes"]
        expected = moving.shown(frame)
        place = expected.vertices[expected.frames.index(frame)]
        # a thousandth of the way to the next frame is on top of the 16 bits of a position
        tolerance = 2e-3 * np.abs(np.diff(expected.vertices, axis=0)).max() + 1e-3
        np.testing.assert_allclose(mesh["corners"], place, atol=tolerance)
        assert 0 < mesh["roughness"] < 1
        picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("L"))
        assert 0.1 < (picture > 20).mean() < 0.9


@contextmanager
def playing(browser, path):
    """A page in which three.js shows a file, and which has no faults."""
    page = patient(browser.new_page(viewport={"width": 200, "height": 200}))
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.route(f"{SITE}**", lambda route: _answer(route, path))
    page.goto(SITE)
    page.wait_for_function("window.ready")
    yield page
    page.close()
    assert faults == []


def _answer(route, path):
    """The page, the file, or a module of three.js."""
    name = route.request.url.removeprefix(SITE)
    if not name:
        route.fulfill(body=PAGE, content_type="text/html")
    elif name == "file.glb":
        route.fulfill(body=path.read_bytes(), content_type="model/gltf-binary")
    elif name.startswith("three/"):
        route.fulfill(path=MODULES / name, content_type="text/javascript")
    else:
        route.fulfill(status=404)
