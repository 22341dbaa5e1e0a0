"""What is wrong with the settings of a process is told in two sentences."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from tests.patience import PATIENCE, until


@pytest.mark.parametrize("command", [["server", "check"], ["worker", "run"], ["worker", "janitor"]])
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("MORPH_WORKRES", "2", "MORPH_WORKERS"),
        ("MORPH_DATA_DIR", "/proc/nowhere", "/proc/nowhere cannot be used"),
        ("MORPH_DATA_DIR", __file__, "writable"),
        ("MORPH_PORT", "tcp://10.0.0.1:80", "MORPH_PORT"),
        ("MORPH_DATABASE_URL", "mysql://morph", "postgresql://"),
        ("MORPH_DATABASE_URL", "nonsense", "postgresql://"),
        ("MORPH_DATABASE_URL", "postgresql://morph:secret@127.0.0.1:1/x", "refused"),
    ],
)
def test_a_wrong_setting_is_named(
    tmp_path: Path, command: list[str], name: str, value: str, words: str
) -> None:
    """No process starts with it, and none shows a traceback or the password."""
    own = {name: text for name, text in os.environ.items() if not name.startswith("MORPH_")}
    module, *arguments = command
    ended = subprocess.run(
        [sys.executable, "-m", f"chamfer_morph.{module}", *arguments],
        env=own | {"MORPH_DATA_DIR": str(tmp_path / "data"), name: value},
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert ended.returncode and words in ended.stderr, ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 2 and "secret" not in ended.stderr


def test_a_tilde_is_the_home_directory(tmp_path: Path) -> None:
    """As files of settings have it, which no shell reads."""
    home, elsewhere = tmp_path / "home", tmp_path / "elsewhere"
    home.mkdir()
    elsewhere.mkdir()
    (home / "secret").write_text("x" * 32)
    own = {name: text for name, text in os.environ.items() if not name.startswith("MORPH_")}
    paths = {"MORPH_DATA_DIR": "~/data", "MORPH_ADMIN_KEY_FILE": "~/secret"}
    subprocess.run(
        [sys.executable, "-m", "chamfer_morph.server", "check"],
        cwd=elsewhere, env=own | paths | {"HOME": str(home)}, timeout=PATIENCE, check=True,
    )  # fmt: skip
    assert (home / "data" / "morph.sqlite").exists()
    assert not any(elsewhere.iterdir())


def test_a_wrong_name_in_a_file_is_named(tmp_path: Path) -> None:
    """Those in .env count as those of the environment do; what is not ours there is left alone."""
    own = {name: text for name, text in os.environ.items() if not name.startswith("MORPH_")}
    command = [sys.executable, "-m", "chamfer_morph.server", "check"]
    (tmp_path / ".env").write_text("OTHER=1\nMORPH_KEY=ours\nMORPH_WORKRES=2\n")
    environment = own | {"MORPH_DATA_DIR": str(tmp_path / "data")}
    ended = subprocess.run(
        command, cwd=tmp_path, env=environment,
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert ended.returncode and "no setting MORPH_WORKRES" in ended.stderr, ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 2 and "MORPH_WORKERS" in ended.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="modes as of POSIX")
def test_the_data_directory_is_for_its_owner_alone(tmp_path: Path) -> None:
    """One that is there keeps what its owner has set."""
    assert Storage(tmp_path / "new").root.stat().st_mode & 0o777 == 0o700
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o750)
    assert Storage(shared).root.stat().st_mode & 0o777 == 0o750


@pytest.mark.skipif(sys.platform == "win32", reason="modes as of POSIX")
@pytest.mark.parametrize("command", [["server", "check"], ["worker", "janitor"]])
def test_files_are_for_their_owner_alone(tmp_path: Path, command: list[str]) -> None:
    """Also in a folder that others may look into, whatever the shell's umask is."""
    data_dir = tmp_path / "data"
    data_dir.mkdir()
    data_dir.chmod(0o755)
    own = {name: text for name, text in os.environ.items() if not name.startswith("MORPH_")}
    module, *arguments = command
    with subprocess.Popen(
        [sys.executable, "-m", f"chamfer_morph.{module}", *arguments],
        env=own | {"MORPH_DATA_DIR": str(data_dir)}, umask=0o022,
    ) as process:  # fmt: skip
        until(lambda: process.poll() is not None or (data_dir / "locks/clock").exists())
        process.terminate()
    made = [*data_dir.rglob("*")]
    assert data_dir / "morph.sqlite" in made
    assert [path for path in made if path.stat().st_mode & 0o077] == []


def test_workers_share_the_memory_of_their_machine() -> None:
    """Unless somebody has said what a job may have."""
    alone = Settings(_env_file=None).memory_per_job
    assert Settings(_env_file=None, workers=4).memory_per_job == alone // 4
    assert Settings(_env_file=None, workers=0).memory_per_job == alone
    assert Settings(_env_file=None, workers=4, job_memory_bytes=7).memory_per_job == 7
