"""`morph doctor`: what it finds on this machine, and on one that lacks something."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from chamfer_morph.cli import doctor
from morph_engine import backend, system_libraries
from morph_engine.errors import DeviceError

WITHOUT_LANDLOCK = """
import ctypes, os, struct, sys

def step(code, jump, value):
    return struct.pack("HBBI", code, 0, jump, value)

# load the number of the call; kill the process where it is landlock_create_ruleset, else allow it
steps = step(0x20, 0, 0) + step(0x15, 1, 444) + step(0x06, 0, 0x80000000)
steps += step(0x06, 0, 0x7FFF0000)
buffer = ctypes.create_string_buffer(steps)
program = struct.pack("HP", 4, ctypes.addressof(buffer))
library = ctypes.CDLL(None)
assert not library.prctl(38, 1, 0, 0, 0)  # PR_SET_NO_NEW_PRIVS
assert not library.prctl(22, 2, program, 0, 0)  # PR_SET_SECCOMP, SECCOMP_MODE_FILTER
os.execv(sys.executable, [sys.executable, "-m", "chamfer_morph", *sys.argv[1:]])
"""
"""Runs `morph` below a system call filter, as systemd sets one."""


def run_doctor(*options: str, **settings: str) -> tuple[int, dict[str, dict[str, str]]]:
    """Exit status and findings by subject."""
    outcome = subprocess.run(
        [sys.executable, "-m", "chamfer_morph", "doctor", "--json", *options],
        env=os.environ | settings, capture_output=True, text=True,
    )  # fmt: skip
    findings = json.loads(outcome.stdout)["findings"]
    return outcome.returncode, {finding["subject"]: finding for finding in findings}


def test_machine_that_has_everything(tmp_path: Path) -> None:
    """Nothing is wrong, and nothing is left behind."""
    status, findings = run_doctor(MORPH_DATA_DIR=str(tmp_path / "data"))
    assert status == 0
    subjects = ["software", "libraries", "memory", "network", "files", "disk", "database", "morph"]
    assert [*findings] == subjects
    assert {finding["verdict"] for finding in findings.values()} <= {"ok", "warning"}
    assert "taichi 1." in findings["software"]["text"]
    assert " on " in findings["morph"]["text"]
    assert any(name in findings["morph"]["text"] for name in backend.available_devices())
    assert not (tmp_path / "data").exists()


def test_database_that_is_there(database_url: str, tmp_path: Path) -> None:
    """It answers."""
    if not database_url:
        (tmp_path / "morph.sqlite").touch()
    settings = {"MORPH_DATA_DIR": str(tmp_path), "MORPH_DATABASE_URL": database_url}
    status, findings = run_doctor("--no-compute", **settings)
    assert status == 0
    assert findings["database"]["verdict"] == "ok"
    assert " ms" in findings["database"]["text"]


@pytest.mark.parametrize(
    ("settings", "subject", "words"),
    [
        ({"MORPH_DATABASE_URL": "postgresql://a@127.0.0.1:9/b"}, "database", "cannot be used"),
        ({"MORPH_DATABASE_URL": "mysql://a"}, "settings", "Postgres"),
        ({"MORPH_DATA_DIR": "/proc/nowhere"}, "disk", "cannot be written"),
        ({"MORPH_WORKRES": "2"}, "settings", "MORPH_WORKRES"),
        ({"MORPH_OBJECT_STORE": "s3://b", "AWS_ENDPOINT_URL": "http://127.0.0.1:9",
          "AWS_ACCESS_KEY_ID": "id", "AWS_SECRET_ACCESS_KEY": "secret"},
         "object store", "does not answer"),
    ],
)  # fmt: skip
def test_machine_that_lacks_something(
    settings: dict[str, str], subject: str, words: str, tmp_path: Path
) -> None:
    """The fault and what to do about it are named, and the exit status says that there is one."""
    status, findings = run_doctor("--no-compute", **{"MORPH_DATA_DIR": str(tmp_path)} | settings)
    assert status == 1
    assert findings[subject]["verdict"] == "fault"
    assert words in findings[subject]["text"]
    assert findings[subject]["remedy"]


@pytest.mark.skipif(sys.platform != "linux", reason="a filter as systemd sets it")
def test_a_filter_that_forbids_landlock(tmp_path: Path) -> None:
    """It would kill every engine, which is more than a lack of Landlock."""
    outcome = subprocess.run(
        [sys.executable, "-c", WITHOUT_LANDLOCK, "doctor", "--json", "--no-compute"],
        env=os.environ | {"MORPH_DATA_DIR": str(tmp_path)}, capture_output=True, text=True,
    )  # fmt: skip
    assert outcome.returncode == 1, outcome.stderr
    findings = {each["subject"]: each for each in json.loads(outcome.stdout)["findings"]}
    assert findings["files"]["verdict"] == "fault"
    assert "filter" in findings["files"]["text"]
    assert "landlock_create_ruleset" in findings["files"]["remedy"]


@pytest.mark.skipif(sys.platform == "win32", reason="modes as of POSIX")
def test_a_folder_that_others_may_read(tmp_path: Path) -> None:
    """It is warned of, with the command that closes it; one that is closed is no news."""
    settings = {"MORPH_DATA_DIR": str(tmp_path)}
    for mode, warned in ((0o700, False), (0o750, True), (0o705, True)):
        tmp_path.chmod(mode)
        status, findings = run_doctor("--no-compute", **settings)
        assert status == 0
        assert ("privacy" in findings) is warned
    assert findings["privacy"]["remedy"] == f"chmod 700 {tmp_path}"


def test_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """The package that has it is named."""
    monkeypatch.setitem(system_libraries.LIBRARIES, "libnowhere.so.1", "libnowhere1")
    found = doctor.check_libraries()
    assert found.verdict == "fault"
    assert found.remedy == "apt-get install libnowhere1"


def test_a_run_without_a_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names it and its package, too, before Taichi is imported."""
    monkeypatch.setitem(system_libraries.LIBRARIES, "libnowhere.so.1", "libnowhere1")
    with pytest.raises(DeviceError, match="without libnowhere") as caught:
        backend.start("cpu")
    assert "apt-get install libnowhere1" in caught.value.remedy
