"""What every test shares: the paper's meshes, a device in the wanted precision, databases."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tarfile
import tempfile
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psycopg
import pytest

ROOT = Path(__file__).resolve().parents[1]
MESHES = Path(os.environ.get("MORPH_MESHES", ROOT.parent / "shared" / "meshes"))


@pytest.fixture
def paper_mesh() -> Callable[[str], Path]:
    """Path of one of the paper's meshes; skips where they are absent."""

    def find(name: str) -> Path:
        path = MESHES / f"{name}.obj"
        if not path.exists():
            pytest.skip(f"{path} is absent; set MORPH_MESHES to the folder of the paper's meshes")
        return path

    return find


@pytest.fixture
def float64_device() -> None:
    """The CPU in float64, for comparisons with exact mathematics."""
    from morph_engine import backend

    backend.start("cpu", precision="float64")


@pytest.fixture
def float32_device() -> None:
    """The CPU in float32, as in production."""
    from morph_engine import backend

    backend.start("cpu")


POSTGRES = "postgresql://postgres@127.0.0.1:5432/postgres"


@pytest.fixture(scope="session")
def postgres() -> Iterator[str]:
    """URL of a real Postgres server: the one of this machine, else a private one."""
    if _answers(POSTGRES):
        yield POSTGRES
        return
    with private_postgres() as server:
        yield server.url


@pytest.fixture(params=["sqlite", "postgres"])
def database_url(request: pytest.FixtureRequest) -> Iterator[str]:
    """A database of the test's own: SQLite (an empty URL) and Postgres."""
    if request.param == "sqlite":
        yield ""
        return
    with empty_database(request.getfixturevalue("postgres")) as url:
        yield url


@pytest.fixture
def other_database_url(database_url: str, request: pytest.FixtureRequest) -> Iterator[str]:
    """A second database of the same kind."""
    if not database_url:
        yield ""
        return
    with empty_database(request.getfixturevalue("postgres")) as url:
        yield url


@contextmanager
def empty_database(server: str) -> Iterator[str]:
    """A database on a Postgres server, which is dropped afterwards."""
    name = f"morph_{uuid.uuid4().hex}"
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute(f"create database {name}")
    yield f"{server.rpartition('/')[0]}/{name}"
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute(f"drop database {name} with (force)")


@pytest.fixture
def own_postgres() -> Iterator[PrivatePostgres]:
    """A Postgres server that the test may stop and start."""
    with private_postgres() as server:
        yield server


@dataclass
class PrivatePostgres:
    """A Postgres server of a test's own, which may be stopped and started."""

    url: str
    control: list[str]

    def run(self, action: str) -> None:
        """Start or stop it."""
        subprocess.run([*self.control, "-w", action], check=True, stdout=subprocess.DEVNULL)


@contextmanager
def private_postgres() -> Iterator[PrivatePostgres]:
    """Start a Postgres server of our own; skips the test where none is installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb")) or [shutil.which("initdb")]
    if not found[-1]:
        pytest.skip("no Postgres answers at 127.0.0.1:5432 and none is installed to start one")
    programs = Path(found[-1]).parent
    user = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
    # Postgres refuses to run as root, and its own user may not enter pytest's directories.
    folder = Path(tempfile.mkdtemp(prefix="morph-postgres-"))
    if user:
        shutil.chown(folder, "postgres")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    data = folder / "data"
    quiet = {"check": True, "stdout": subprocess.DEVNULL}
    subprocess.run(
        [*user, programs / "initdb", "-D", data, "-A", "trust", "-U", "postgres", "-N"], **quiet
    )
    options = f"-p {port} -k {folder} -c listen_addresses=127.0.0.1"
    control = [*user, str(programs / "pg_ctl"), "-D", str(data), "-o", options]
    control += ["-m", "immediate", "-l", str(folder / "log")]
    server = PrivatePostgres(f"postgresql://postgres@127.0.0.1:{port}/postgres", control)
    server.run("start")
    try:
        yield server
    finally:
        server.run("stop")
        shutil.rmtree(folder)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 12 MB; skips where mounting is not allowed."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=12m", "morph", folder]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("mounting a small file system is not allowed here")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def _answers(url: str) -> bool:
    try:
        psycopg.connect(url, connect_timeout=2).close()
    except psycopg.OperationalError:
        return False
    return True


def extraction_filter() -> dict[str, str]:
    """What newer Pythons want to be told about an archive that one trusts; 3.11.2 cannot be."""
    return {"filter": "data"} if hasattr(tarfile, "data_filter") else {}


@pytest.fixture
def version_0_1_0(tmp_path: Path) -> Path:
    """A folder of what version 0.1.0 left behind.

    METHOD.vtkhdf of three frames, METHOD-unfinished.vtkhdf.spool of two, for `transport`, `joint`
    and `dco`, computed on one thread; and `data`, the folder of a service with three jobs.
    """
    folder = tmp_path / "version_0_1_0"
    with tarfile.open(Path(__file__).parent / "data" / "version_0_1_0" / "files.tar.xz") as archive:
        archive.extractall(folder, **extraction_filter())
    return folder
