"""A morph of the Blender add-on, in a process without Blender."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

ADDON = Path(__file__).resolve().parents[2] / "blender"

EXPORT = {"state": "ready", "progress": 1.0, "links": {"self": "/export", "file": "/file"}}


@pytest.fixture
def addon(monkeypatch):
    """The module of morphs, without the add-on's own, which is Blender's alone."""
    package = ModuleType("addon")
    package.__path__ = [str(ADDON)]
    monkeypatch.setitem(sys.modules, "addon", package)
    morph = import_module("addon.morph")
    monkeypatch.setattr(morph, "SECONDS_BETWEEN_LOOKS", 0.0)
    monkeypatch.setattr(morph, "SECONDS_BETWEEN_TRIES", 0.0)
    yield morph
    for name in ("addon.morph", "addon.service"):
        sys.modules.pop(name)


class Faulty:
    """A service that answers once it has failed so often.

    Attributes:
        asked: How often it was asked for its job.
    """

    def __init__(self, failure: Exception, failures: int) -> None:
        self.asked = 0
        self._failure, self._failures = failure, failures

    def upload(self, mesh):
        """Its name for an id."""
        return mesh.stem

    def submit(self, request):
        """Always the same job."""
        return "job"

    def job(self, job):
        """Done, or a failure."""
        self.asked += 1
        if self.asked <= self._failures:
            raise self._failure
        return {"state": "succeeded"}

    def begin_export(self, job, request):
        """Ready at once."""
        return EXPORT

    def download(self, path, to):
        """Not much of a file."""
        to.write_bytes(b"glTF")


def made(addon, folder, service):
    """A morph that has ended."""
    source, target, result = (folder / name for name in ("source.glb", "target.glb", "morph.glb"))
    request = addon.Request(source, target, result, "fast", 2, 8, 1.0, 24.0, snap=True)
    morph = addon.Morph(service, request)
    morph.start()
    morph.wait()
    return morph


@pytest.mark.parametrize("status", [0, 429, 503])
def test_a_service_that_is_away_for_a_while_is_waited_for(addon, tmp_path, status):
    """Whoever starts it again in the night has the morph in the morning."""
    service = Faulty(addon.ServiceError("Not now.", status), failures=3)
    morph = made(addon, tmp_path, service)
    assert (morph.error, service.asked) == ("", 4)
    assert (tmp_path / "morph.glb").read_bytes() == b"glTF"


def test_a_service_that_stays_away_is_told_of(addon, tmp_path, monkeypatch):
    """When nobody can hope any more."""
    monkeypatch.setattr(addon, "PATIENCE_SECONDS", -1.0)
    service = Faulty(addon.ServiceError("No morph service answers."), failures=1)
    assert made(addon, tmp_path, service).error == "No morph service answers."


def test_a_refusal_is_told_at_once(addon, tmp_path):
    """A job that is not there does not come back."""
    service = Faulty(addon.ServiceError("There is no such job.", 404), failures=1)
    morph = made(addon, tmp_path, service)
    assert (morph.error, service.asked) == ("There is no such job.", 1)
