"""Meshes fetched from a real web server on this machine that fails as told."""

from __future__ import annotations

import hashlib
import io
import socket
import tarfile
import zipfile

import numpy as np
import pytest
import trimesh

from chamfer_morph.cli import web_download
from chamfer_morph.cli.mesh_fetch import MeshFetch
from chamfer_morph.reproduction import archive
from chamfer_morph.reproduction.originals import Facts, Original, Recipe
from morph_engine.errors import MeshError
from morph_engine.files import acquire
from morph_engine.geometry.mesh import load_mesh, make_mesh
from tests.web_server import running

PROXY_VARIABLES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "NO_PROXY")


@pytest.fixture
def web(monkeypatch):
    """A web server without proxies on the way."""
    for name in PROXY_VARIABLES:
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setattr(web_download, "FIRST_PAUSE_SECONDS", 0.01)
    with running() as server:
        server.files["box.zip"] = zipped(box())
        yield server


def box(size=(1, 2, 3)):
    """A box as OBJ, of 100 kB: more than any network buffers."""
    obj = trimesh.creation.box(size).export(file_type="obj", header=None)
    noise = np.random.default_rng(0).bytes(50_000).hex()
    return f"{obj}\n# {noise}\n".encode()


def zipped(content, name="folder/box.obj"):
    """An archive of one file."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr(name, content)
    return buffer.getvalue()


def sha256(content):
    """Digest in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def doubled(mesh):
    """Twice as large."""
    return make_mesh(2 * mesh.vertices, mesh.faces, name="box")


def recipes(url, facts=None, sha256=""):
    """One mesh that is its original twice as large."""
    original = Original(f"{url}/box.zip", "box.obj", "nobody", sha256)
    return {"box.obj": Recipe(original, doubled, facts or Facts(12, 48.0, 88.0))}


def fetch(folder, url, *, facts=None, sha256="", **options):
    """Fetch the box."""
    return MeshFetch(folder, recipes=recipes(url, facts, sha256), **options).run()


def left_behind(folder):
    """Files of the folder of originals."""
    return sorted(path.name for path in (folder / "originals").iterdir() if path.name != ".lock")


def test_a_mesh_is_fetched_placed_and_recorded(web, tmp_path):
    """The list that is written is one that sha256sum reads: digest, two spaces, path."""
    (mesh,) = fetch(tmp_path, web.url)
    assert (mesh.origin, mesh.checked, mesh.stands_in) == ("original", "recorded now", False)
    assert mesh.sha256 == sha256(web.files["box.zip"])
    np.testing.assert_array_equal(load_mesh(tmp_path / "box.obj").bounds, [[-1, -2, -3], [1, 2, 3]])
    assert (tmp_path / "SHA256SUMS").read_text() == (
        f"{sha256((tmp_path / 'box.obj').read_bytes())}  box.obj\n"
        f"{mesh.sha256}  originals/box.zip\n"
    )
    assert left_behind(tmp_path) == ["box.zip"]


def test_what_is_there_and_sound_is_not_fetched_again(web, tmp_path):
    """Nor does it need the network."""
    fetch(tmp_path, web.url)
    fetch(tmp_path, web.url)
    (tmp_path / "box.obj").unlink()
    (mesh,) = fetch(tmp_path, web.url)
    assert mesh.checked == "as known"
    assert (tmp_path / "box.obj").exists() and len(web.requests) == 1


def test_a_download_that_breaks_off_goes_on_where_it_was(web, tmp_path):
    """Twice cut, it asks for the rest, of the same version of the file."""
    web.cuts = [30_000, 20_000]
    fetch(tmp_path, web.url)
    assert web.ranges() == ["", "bytes=30000-", "bytes=50000-"]
    assert (tmp_path / "originals" / "box.zip").read_bytes() == web.files["box.zip"]


def test_an_interrupted_download_goes_on_with_the_next_command(web, tmp_path):
    """It gives up after five attempts that bring nothing, says so, and keeps what has arrived."""
    web.cuts = [30_000, 0, 0, 0, 0, 0]
    with pytest.raises(MeshError, match=r"stopped after 30000 bytes.*repeat the command"):
        fetch(tmp_path, web.url)
    assert left_behind(tmp_path) == ["box.zip.part", "box.zip.part.version"]
    web.cuts, before = [], len(web.requests)
    fetch(tmp_path, web.url)
    assert web.ranges()[before:] == ["bytes=30000-"]
    assert left_behind(tmp_path) == ["box.zip"]


def test_a_file_that_has_changed_meanwhile_is_fetched_from_its_beginning(web, tmp_path):
    """Parts of two versions are never joined."""
    web.cuts = [30_000, 0, 0, 0, 0, 0]
    with pytest.raises(MeshError):
        fetch(tmp_path, web.url)
    web.cuts, web.files["box.zip"] = [], zipped(box() + b"# new\n")
    fetch(tmp_path, web.url)
    assert (tmp_path / "originals" / "box.zip").read_bytes() == web.files["box.zip"]


def test_a_server_without_ranges_sends_it_all_again(web, tmp_path):
    """And the file is whole all the same."""
    web.understands_ranges, web.cuts = False, [30_000]
    fetch(tmp_path, web.url)
    assert web.ranges() == ["", ""]
    assert (tmp_path / "originals" / "box.zip").read_bytes() == web.files["box.zip"]


def test_a_part_that_is_longer_than_the_file_is_dropped(web, tmp_path):
    """The server answers 416, and the next request asks for all."""
    web.cuts = [60_000, 0, 0, 0, 0, 0]
    with pytest.raises(MeshError):
        fetch(tmp_path, web.url)
    part = tmp_path / "originals" / "box.zip.part"
    part.write_bytes(part.read_bytes() + bytes(100_000))
    web.cuts = []
    fetch(tmp_path, web.url)
    assert web.ranges()[-1] == ""


def test_a_busy_server_is_asked_again(web, tmp_path):
    """503 passes."""
    web.statuses = [503, 429]
    fetch(tmp_path, web.url)
    assert len(web.requests) == 3


def test_wrong_bytes_are_refused_and_removed(web, tmp_path):
    """The digest is known: by the catalogue, by the record of the first time, or by a list."""
    right, wrong = web.files["box.zip"], zipped(box((1, 2, 4)))
    web.files["box.zip"] = wrong
    with pytest.raises(MeshError, match=f"{sha256(wrong)}, not {sha256(right)}; it has been"):
        fetch(tmp_path, web.url, sha256=sha256(right))
    assert left_behind(tmp_path) == []
    sums = tmp_path / "sums"
    sums.write_text(f"{sha256(right)}  anywhere/box.zip\n")
    with pytest.raises(MeshError, match="has been removed"):
        fetch(tmp_path, web.url, checksums=sums)
    assert left_behind(tmp_path) == [] and not (tmp_path / "box.obj").exists()
    web.files["box.zip"] = right
    (mesh,) = fetch(tmp_path, web.url, checksums=sums)
    assert mesh.checked == "as known"
    web.files["box.zip"] = wrong
    for path in (tmp_path / "originals" / "box.zip", tmp_path / "box.obj"):
        path.unlink()
    with pytest.raises(MeshError, match="a list with its new digest as --checksums"):
        fetch(tmp_path, web.url)
    assert left_behind(tmp_path) == []


def test_a_list_overrules_the_catalogue(web, tmp_path):
    """So an original that its author has changed can still be had."""
    sums = tmp_path / "sums"
    sums.write_text(f"{sha256(web.files['box.zip'])}  box.zip\n")
    (mesh,) = fetch(tmp_path, web.url, sha256=sha256(b"older"), checksums=sums)
    assert mesh.checked == "as known"


def test_another_mesh_than_the_papers_is_refused_and_removed(web, tmp_path):
    """Without a known digest its triangles, volume and area tell."""
    web.files["box.zip"] = zipped(box((1, 2, 3.001)))
    with pytest.raises(MeshError, match=r"12 triangles, volume 48\.02") as caught:
        fetch(tmp_path, web.url)
    assert "--from" in caught.value.remedy
    assert left_behind(tmp_path) == [] and not (tmp_path / "box.obj").exists()
    web.files["box.zip"] = zipped(box())
    fetch(tmp_path, web.url)


def test_what_rots_on_the_disk_is_put_right(web, tmp_path):
    """A damaged original is fetched again, a damaged mesh is made again."""
    fetch(tmp_path, web.url)
    sound = (tmp_path / "box.obj").read_bytes()
    (tmp_path / "box.obj").write_bytes(sound[:-10])
    (tmp_path / "originals" / "box.zip").write_bytes(b"rotten")
    fetch(tmp_path, web.url)
    assert (tmp_path / "box.obj").read_bytes() == sound and len(web.requests) == 2


def test_a_mesh_of_the_users_own_is_left_alone(web, tmp_path):
    """It is in no record, and nothing is written beside it."""
    (tmp_path / "box.obj").write_bytes(b"mine")
    (mesh,) = fetch(tmp_path, web.url)
    assert mesh.origin == "yours" and not web.requests
    digest = sha256(b"mine")
    (tmp_path / "SHA256SUMS").write_text(f"{digest}  box.obj\n")  # nor if the user recorded it
    fetch(tmp_path, web.url)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["SHA256SUMS", "box.obj"]


def test_an_absent_file_says_what_to_do(web, tmp_path):
    """404 is not asked for again."""
    del web.files["box.zip"]
    with pytest.raises(MeshError, match=r"404 Not Found.*--from.*has box\.zip"):
        fetch(tmp_path, web.url)
    assert len(web.requests) == 1 and left_behind(tmp_path) == []


def test_no_connection_says_what_to_do(web, tmp_path):
    """An address at which nobody listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(MeshError, match=r"cannot be reached.*HTTPS_PROXY.*--from"):
        fetch(tmp_path, url)


def test_the_proxy_of_the_environment_is_used(web, tmp_path, monkeypatch):
    """A host that nobody else can resolve; NO_PROXY goes past the proxy."""
    monkeypatch.setenv("HTTP_PROXY", web.url)
    fetch(tmp_path, "http://originals.invalid")
    assert [target for target, _ in web.requests] == ["http://originals.invalid/box.zip"]
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:1")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    fetch(tmp_path / "direct", web.url)


def test_a_proxy_of_an_unknown_kind_is_named(web, tmp_path, monkeypatch):
    """The remedy names the variables."""
    monkeypatch.setenv("HTTP_PROXY", "gopher://127.0.0.1:70")
    with pytest.raises(MeshError, match=r"proxy of the environment.*HTTPS_PROXY"):
        fetch(tmp_path, web.url)


def test_a_mirror_may_be_an_address_or_a_folder(web, tmp_path):
    """It has the originals under their names."""
    web.files["mirror/box.zip"] = web.files.pop("box.zip")
    fetch(tmp_path / "a", "http://originals.invalid", place=f"{web.url}/mirror/")
    originals = str(tmp_path / "a" / "originals")
    fetch(tmp_path / "b", "http://originals.invalid", place=originals)
    a, b = ((tmp_path / name / "box.obj").read_bytes() for name in "ab")
    assert a == b
    with pytest.raises(
        MeshError, match=r"There is no box\.zip in the folder .*Download it from http"
    ):
        fetch(tmp_path / "c", "http://originals.invalid", place=str(tmp_path))


def test_a_file_that_never_ends_is_not_fetched_to_its_end(web, tmp_path, monkeypatch):
    """Beyond the limit it is dropped."""
    monkeypatch.setattr(web_download, "SIZE_LIMIT", 50_000)
    with pytest.raises(MeshError, match="so it is not the expected file"):
        fetch(tmp_path, web.url)
    assert left_behind(tmp_path) == []


def test_a_list_that_is_none_is_refused(web, tmp_path):
    """So is one that is absent."""
    (tmp_path / "sums").write_text("box.zip is fine\n")
    with pytest.raises(MeshError, match="not a list of SHA-256 digests"):
        fetch(tmp_path, web.url, checksums=tmp_path / "sums")
    with pytest.raises(MeshError, match="There is no list"):
        fetch(tmp_path, web.url, checksums=tmp_path / "absent")


def test_one_command_at_a_time(web, tmp_path):
    """The second says so."""
    (tmp_path / "originals").mkdir()
    with acquire(tmp_path / "originals" / ".lock"):
        with pytest.raises(MeshError, match="Another command is fetching"):
            fetch(tmp_path, web.url)


def test_nothing_is_fetched_where_nothing_is_wanted(web, tmp_path):
    """As for a table of built-in shapes."""
    assert MeshFetch(tmp_path / "new", recipes=recipes(web.url)).run([]) == []
    assert not web.requests and not (tmp_path / "new").exists()


def test_an_unknown_mesh_is_named(web, tmp_path):
    """With the nearest of those there are."""
    with pytest.raises(MeshError, match=r"There is no mesh called 'bix\.obj'"):
        MeshFetch(tmp_path, recipes=recipes(web.url)).run(["bix.obj"])


class TestArchives:
    """Archives are read, never unpacked."""

    @pytest.mark.parametrize("name", ["../../box.obj", "/tmp/box.obj", "a/../../../box.obj"])
    def test_paths_that_lead_out_lead_nowhere(self, tmp_path, name):
        """The content is handed out, and nothing is written."""
        path = tmp_path / "a" / "b" / "evil.zip"
        path.parent.mkdir(parents=True)
        path.write_bytes(zipped(b"content", name))
        assert archive.read_member(path, "box.obj") == b"content"
        assert [each for each in tmp_path.rglob("*") if each.is_file()] == [path]

    def test_links_are_not_followed(self, tmp_path):
        """A link of the wanted name is none of its files."""
        path = tmp_path / "links.tar.gz"
        with tarfile.open(path, "w:gz") as tar:
            for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE):
                entry = tarfile.TarInfo("box.obj")
                entry.type, entry.linkname = kind, "/etc/hostname"
                tar.addfile(entry)
        with pytest.raises(MeshError, match=r"There is no box\.obj in links"):
            archive.read_member(path, "box.obj")

    def test_bombs_do_not_go_off(self, tmp_path, monkeypatch):
        """Neither as the file itself nor on the way to it."""
        monkeypatch.setattr(archive, "FILE_LIMIT", 1000)
        monkeypatch.setattr(archive, "ARCHIVE_LIMIT", 2000)
        (tmp_path / "bomb.zip").write_bytes(zipped(bytes(1001)))
        with tarfile.open(tmp_path / "bomb.tar.gz", "w:gz") as tar:
            for name, size in (("first", 5000), ("box.obj", 1)):
                entry = tarfile.TarInfo(name)
                entry.size = size
                tar.addfile(entry, io.BytesIO(bytes(size)))
        for name in ("bomb.zip", "bomb.tar.gz"):
            with pytest.raises(MeshError, match="too large when unpacked"):
                archive.read_member(tmp_path / name, "box.obj")

    @pytest.mark.parametrize("kind", ["zip", "tar.gz"])
    def test_damage_is_found_at_any_byte(self, tmp_path, kind):
        """Cut or changed, the archive's own checksum tells, or the content is what it was."""
        content = np.random.default_rng(1).bytes(3000)
        path = tmp_path / f"box.{kind}"
        if kind == "zip":
            path.write_bytes(zipped(content, "box.obj"))
        else:
            with tarfile.open(path, "w:gz") as tar:
                entry = tarfile.TarInfo("box.obj")
                entry.size = len(content)
                tar.addfile(entry, io.BytesIO(content))
        whole = path.read_bytes()
        for at in range(0, len(whole), 97):
            for damaged in (whole[:at], whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :]):
                path.write_bytes(damaged)
                try:
                    assert archive.read_member(path, "box.obj") == content
                except MeshError:
                    pass
