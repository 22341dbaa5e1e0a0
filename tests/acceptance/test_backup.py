"""A backup of a service at work, and the service made anew from it elsewhere."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from chamfer_morph.schemas import JobState
from morph_engine.files import file_sha256


def morph(environment, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command with the variables of a cluster."""
    return subprocess.run(
        [sys.executable, "-m", "chamfer_morph", *map(str, arguments)],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.faults
def test_backup_under_load(new_cluster, database_url, other_database_url, undisturbed, tmp_path):
    """Finished jobs are the same to the byte; running and waiting ones go on elsewhere."""
    here = new_cluster(database_url)
    here.worker()
    done = here.submit()
    here.require_sound(done, undisturbed)
    running, waiting = here.submit(), here.submit()
    here.wait_for_frame(running, 5)
    folder = tmp_path / "backup"
    made = morph(here.environment, "backup", folder, "--json")
    assert made.returncode == 0, made.stderr
    assert json.loads(made.stdout)["files"] > 2
    frames_then = here.frames(running)
    here.close()

    place = {"MORPH_DATA_DIR": str(tmp_path / "other"), "MORPH_DATABASE_URL": other_database_url}
    restored = morph(here.environment | place, "restore", folder)
    assert restored.returncode == 0, restored.stderr
    there = new_cluster(other_database_url, tmp_path / "other")
    copy = there.storage.result_path(done)
    assert file_sha256(copy) == file_sha256(here.storage.result_path(done))
    assert there.job(done).state is JobState.SUCCEEDED
    there.start("janitor")
    there.worker()
    for job in (running, waiting):
        there.require_sound(job, undisturbed)
    assert there.frames(running)[:6] == frames_then[:6]


def test_backup_is_brought_up_to_date(new_cluster, tmp_path):
    """What has come is copied, what was deleted goes; all else is left as it is."""
    service = new_cluster("")
    jobs = service.storage.root / "jobs"
    for name in ("kept", "deleted"):
        (jobs / name / "derived").mkdir(parents=True)
        (jobs / name / "log.txt").write_text(name)
        (jobs / name / "derived" / "surface.npz").write_text("made again on request")
    folder = tmp_path / "backup"
    assert json.loads(morph(service.environment, "backup", folder, "--json").stdout)["files"] == 2
    before = (folder / "jobs/kept/log.txt").stat()

    (jobs / "deleted" / "log.txt").unlink()
    (jobs / "new").mkdir()
    (jobs / "new" / "log.txt").write_text("new")
    made = morph(service.environment, "backup", folder)
    assert made.returncode == 0, made.stderr
    assert sorted(path.name for path in (folder / "jobs").iterdir()) == ["kept", "new"]
    assert (folder / "jobs/kept/log.txt").stat().st_ino == before.st_ino
    assert made.stderr.startswith("1 files copied")


@pytest.mark.parametrize("what", ["jobs", "meshes"])
def test_restore_names_what_was_damaged(new_cluster, tmp_path, what):
    """A result or a mesh with a byte turned is found, and restored only if that is asked for."""
    here = new_cluster("")
    upload = here.storage.uploads / "cube.part"
    upload.write_text("v 0 0 0\n")
    here.storage.add_mesh(upload, file_sha256(upload), "obj", {})
    here.worker()
    here.wait_for_state(here.submit(frames=1), JobState.SUCCEEDED)
    folder, place = tmp_path / "backup", {"MORPH_DATA_DIR": str(tmp_path / "other")}
    assert morph(here.environment, "backup", folder).returncode == 0
    (damaged,) = folder.glob({"jobs": "jobs/*/result.vtkhdf", "meshes": "meshes/*/mesh.obj"}[what])
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)

    name = damaged.relative_to(folder).as_posix()
    refused = morph(here.environment | place, "restore", folder)
    assert refused.returncode == 2
    assert name in refused.stderr and "Use another backup" in refused.stderr
    record = json.loads((folder / "backup.json").read_text())
    assert len(record["digests"]) == 2
    del record["digests"][name]
    (folder / "backup.json").write_text(json.dumps(record))
    assert morph(here.environment | place, "restore", folder).returncode == 0


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("none", "A service already exists here."),
        ("no record", "does not contain a complete backup."),
        ("file lost", "missing or have changed"),
        ("bit of the dump turned", "missing or have changed"),
        ("other kind", "This is a backup of postgres."),
    ],
)
def test_restore_refuses(new_cluster, tmp_path, fault, message):
    """A service in use, and what is not a whole backup of its kind."""
    service = new_cluster("")
    (service.storage.root / "jobs" / "one").mkdir()
    (service.storage.root / "jobs" / "one" / "log.txt").write_text("text")
    folder = tmp_path / "backup"
    assert morph(service.environment, "backup", folder).returncode == 0
    record = folder / "backup.json"
    if fault == "no record":
        record.unlink()
    elif fault == "file lost":
        (folder / "jobs/one/log.txt").unlink()
    elif fault == "bit of the dump turned":
        dumped = bytearray((folder / "database.dump").read_bytes())
        dumped[len(dumped) // 2] ^= 1
        (folder / "database.dump").write_bytes(dumped)
    elif fault == "other kind":
        record.write_text(record.read_text().replace("sqlite", "postgres"))
    refused = morph(service.environment, "restore", folder)
    assert refused.returncode == 2
    assert message in refused.stderr


@pytest.mark.parametrize("command", ["backup", "restore"])
def test_a_full_disk_is_told(new_cluster, small_disk, tmp_path, command):
    """With the place and what to do about it; once there is room the same command succeeds."""
    service = new_cluster("")
    (service.storage.root / "jobs" / "one").mkdir()
    (service.storage.root / "jobs" / "one" / "log.txt").write_bytes(bytes(1 << 22))
    environment, folder = service.environment, small_disk / "backup"
    if command == "restore":
        folder = tmp_path / "backup"
        assert morph(environment, "backup", folder).returncode == 0
        environment = environment | {"MORPH_DATA_DIR": str(small_disk / "data")}
    filling = small_disk / "filling"
    filling.write_bytes(bytes(10 << 20))
    refused = morph(environment, command, folder, "--quiet")
    assert refused.returncode == 2, refused.stderr
    cause, remedy = refused.stderr.splitlines()
    assert f"The {command} has stopped at {small_disk}" in cause and "No space" in cause
    assert "free space" in remedy
    filling.unlink()
    assert morph(environment, command, folder, "--quiet").returncode == 0


@pytest.mark.skipif(sys.platform != "linux", reason="a folder in which nothing can be made")
def test_a_place_that_cannot_be_written_to_is_told(new_cluster):
    """As a read-only disk is."""
    refused = morph(new_cluster("").environment, "backup", "/proc/backup", "--quiet")
    assert refused.returncode == 2
    assert "The backup has stopped at /proc/backup" in refused.stderr


def test_backup_refuses_a_folder_with_other_files(new_cluster, tmp_path):
    """Nothing in it is touched."""
    (tmp_path / "diary.txt").write_text("mine")
    refused = morph(new_cluster("").environment, "backup", tmp_path)
    assert refused.returncode == 2
    assert "contains files that do not belong to a backup" in refused.stderr
    assert (tmp_path / "diary.txt").read_text() == "mine"
