"""`morph shapes fetch` and `morph reproduce --fetch` as a user meets them, in an empty home."""

from __future__ import annotations

import hashlib
import io
import json
import os
import signal
import subprocess
import sys
import tarfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from chamfer_morph.reproduction.meshes import ASSETS, MeshFolder
from chamfer_morph.reproduction.originals import RECIPES
from morph_engine.geometry.mesh import load_mesh
from tests.patience import PATIENCE
from tests.web_server import running

MORPH = Path(sys.executable).with_name("morph")
SAME = 1.5e-5
"""Six decimals of the original, up to 12.5 times as large, in each of three coordinates."""

SPHERE = 1e-4
"""The program that made the paper's has the corners of its icosahedron to six digits."""


def environment(home, **more):
    """An empty home and no settings or proxies of whoever runs the tests."""
    kept = {
        name: value for name, value in os.environ.items()
        if not name.startswith("MORPH_") and not name.lower().endswith("_proxy")
    }  # fmt: skip
    return kept | {"HOME": str(home)} | more


def morph(*arguments, home, **more):
    """Run the command to its end and capture what it prints."""
    return subprocess.run(
        [MORPH, *map(str, arguments)],
        cwd=home, env=environment(home, **more), capture_output=True, text=True, timeout=600,
    )  # fmt: skip


@pytest.fixture(scope="module")
def originals():
    """The public originals as far as the paper's files tell: theirs, turned and scaled back."""
    folder = Path(os.environ.get("MORPH_MESHES", Path(__file__).parents[3] / "shared" / "meshes"))
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent; set MORPH_MESHES to the folder of the paper's meshes")

    def original(name, scale, axes, signs=(1, 1, 1), offset=(0, 0, 0)):
        mesh = load_mesh(folder / name)
        vertices = ((mesh.vertices - offset) / scale)[:, axes] * signs
        return trimesh.Trimesh(np.round(vertices, 6), mesh.faces, process=False)

    def text(mesh, kind):
        exported = mesh.export(file_type=kind, **({"encoding": "ascii"} if kind == "ply" else {}))
        return exported.encode() if isinstance(exported, str) else exported

    def zipped(name, content):
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"__MACOSX/x/._{Path(name).name}", b"resource fork")
            archive.writestr(name, content)
        return buffer.getvalue()

    def tarred(name, content):
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
            for each, data in (("a/README", b"terms"), (name, content), ("a/more.ply", b"more")):
                entry = tarfile.TarInfo(each)
                entry.size = len(data)
                archive.addfile(entry, io.BytesIO(data))
        return buffer.getvalue()

    spot = original("cow.obj", 11, [0, 2, 1], (-1, 1, 1), (0, -1.1, -1.1))
    bob = original("duck.obj", 12.5, [1, 2, 0])
    bunny = original("bunny.obj", 115.5, [1, 2, 0], offset=(-0.958512, 3.094644, -10.872816))
    dragon = original("dragon.obj", 126.8, [2, 1, 0], (1, 1, -1))
    teapot = original("teapot.obj", 4, [1, 2, 0], offset=(0, 0, -5))
    return {
        "spot.zip": zipped("spot/spot_triangulated.obj", text(spot, "obj")),
        "bob.zip": zipped("bob/bob_tri.obj", text(bob, "obj")),
        "bunny.tar.gz": tarred("bunny/reconstruction/bun_zipper.ply", text(bunny, "ply")),
        "dragon_recon.tar.gz": tarred("dragon_recon/dragon_vrip_res3.ply", text(dragon, "ply")),
        "teapot.obj": text(teapot, "obj"),
    }, folder


@pytest.fixture
def sums(originals, tmp_path):
    """A list of their digests, which are not those of the files that the public has."""
    path = tmp_path / "originals.sha256"
    lines = (f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in originals[0].items())
    path.write_text("".join(lines))
    return path


@pytest.fixture
def web(originals):
    """A mirror of the originals."""
    with running() as server:
        server.files |= originals[0]
        yield server


def test_one_command_puts_everything_in_place(web, originals, sums, tmp_path):
    """Public meshes vertex by vertex as the paper has them, others within their bounds."""
    outcome = morph(
        "shapes", "fetch", "--from", web.url, "--checksums", sums, "--json", home=tmp_path
    )
    assert outcome.returncode == 0, outcome.stderr
    document = json.loads(outcome.stdout)
    assert document["folder"] == "meshes"
    meshes = {mesh["name"]: mesh for mesh in document["meshes"]}
    assert list(meshes) == list(ASSETS) == list(RECIPES)
    folder = tmp_path / "meshes"
    MeshFolder(folder).check(ASSETS)
    exact = {"bunny.obj", "duck.obj", "duck_y90.obj", "cow.obj", "teapot.obj", "sphere.obj"}
    assert {name for name, mesh in meshes.items() if mesh["stands_in"] is False} == exact
    for name in exact:
        ours, papers = load_mesh(folder / name), load_mesh(originals[1] / name)
        assert len(ours.faces) == len(papers.faces)
        distance, _ = KDTree(papers.vertices).query(ours.vertices)
        assert distance.max() < (SPHERE if name == "sphere.obj" else SAME), name
    np.testing.assert_allclose(
        load_mesh(folder / "dragon.obj").bounds,
        load_mesh(originals[1] / "dragon.obj").bounds,
        atol=1e-3,  # six decimals of the original, 127 times as large
    )
    sums = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=folder, capture_output=True)
    assert sums.returncode == 0, sums.stderr
    again = morph("shapes", "fetch", home=tmp_path)
    assert again.returncode == 0 and again.stderr == ""
    assert len(web.requests) == 5


def test_a_killed_download_is_resumed_by_the_same_command(web, sums, tmp_path):
    """Ctrl-C in the midst: exit status 130, what has arrived is kept, and the rest is asked for."""
    with running() as slow:
        whole = web.files["bunny.tar.gz"]
        slow.files["bunny.tar.gz"] = whole
        slow.pauses = [100_000]
        command = "shapes", "fetch", "bunny.obj", "--from", slow.url, "--checksums", str(sums)
        process = subprocess.Popen(
            [MORPH, *command],
            cwd=tmp_path, env=environment(tmp_path), stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        part = tmp_path / "meshes" / "originals" / "bunny.tar.gz.part"
        deadline = time.monotonic() + PATIENCE
        while not (part.exists() and part.stat().st_size):
            assert time.monotonic() < deadline
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        assert "what has been downloaded is kept" in process.communicate(timeout=120)[1]
        assert process.returncode == 130
        arrived = part.stat().st_size
        assert 0 < arrived <= 100_000
        outcome = morph(*command, home=tmp_path)
        assert outcome.returncode == 0, outcome.stderr
        assert slow.ranges() == ["", f"bytes={arrived}-"]
    assert part.with_suffix("").read_bytes() == whole


def test_wrong_and_absent_originals_end_with_a_cause_and_a_remedy(web, tmp_path):
    """Exit status 2; the bad file does not stay."""
    web.files["spot.zip"] = web.files.pop("bob.zip")
    outcome = morph("shapes", "fetch", "cow.obj", "--from", web.url, home=tmp_path)
    assert outcome.returncode == 2 and "no spot_triangulated.obj in spot.zip" in outcome.stderr
    outcome = morph("shapes", "fetch", "duck.obj", "--from", web.url, home=tmp_path)
    assert outcome.returncode == 2 and "404 Not Found" in outcome.stderr
    assert outcome.stderr.endswith("another URL or a folder that has bob.zip.\n")
    assert not list((tmp_path / "meshes").glob("**/*.zip*"))


def test_another_file_than_the_public_original_is_refused(web, tmp_path):
    """What the mirror has as the bunny is no file of Stanford's."""
    outcome = morph("shapes", "fetch", "bunny.obj", "--from", web.url, home=tmp_path)
    assert outcome.returncode == 2
    assert f", not {RECIPES['bunny.obj'].original.sha256}; it has been removed" in outcome.stderr
    assert not list((tmp_path / "meshes").glob("**/bunny*"))


def test_reproduce_fetches_what_is_missing(web, tmp_path):
    """Through the proxy of the environment, here to their own addresses over HTTPS, which fail."""
    outcome = morph("reproduce", "sphere", "--fetch", home=tmp_path, HTTPS_PROXY=web.url)
    assert outcome.returncode == 2
    assert RECIPES["bunny.obj"].original.url in outcome.stderr
    assert "--fetch or morph shapes fetch" in morph("reproduce", "sphere", home=tmp_path).stderr
