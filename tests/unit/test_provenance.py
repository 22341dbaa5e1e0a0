"""Who computed a run: commit, machine, and the times of its parts."""

from __future__ import annotations

import subprocess
from datetime import datetime, timezone

import pytest

from morph_engine.code_digest import code_digest
from morph_engine.machine_cores import usable_cores
from morph_engine.results import provenance
from morph_engine.results.provenance import Provenance, provenance_by_now


@pytest.fixture
def commit_of(tmp_path, monkeypatch):
    """Tells the commit of a package that lies in a folder of its own; the folder, too."""
    module = tmp_path / "provenance.py"
    module.write_text("")
    monkeypatch.setattr(provenance, "__file__", str(module))
    return provenance.commit.__wrapped__, tmp_path


def git(folder, *arguments):
    """Run git, and return what it prints."""
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@example.org", *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=True
    ).stdout.strip()  # fmt: skip


def test_a_checkout_is_named_by_its_commit_and_by_its_changes(commit_of):
    """None outside, none where another project's repository is around, then the commit."""
    commit, folder = commit_of
    assert commit() == ""
    git(folder, "init", "--quiet")
    (folder / "another.txt").write_text("")
    git(folder, "add", "another.txt")
    git(folder, "commit", "--quiet", "-m", "Another project")
    assert commit() == ""
    git(folder, "add", "provenance.py")
    git(folder, "commit", "--quiet", "-m", "This package")
    assert commit() == git(folder, "rev-parse", "HEAD")
    (folder / "provenance.py").write_text("changed")
    assert commit() == f"{git(folder, 'rev-parse', 'HEAD')}-dirty"


def test_without_git_there_is_no_commit(commit_of, monkeypatch):
    """An installed package on a machine that has no git."""
    commit, folder = commit_of
    monkeypatch.setenv("PATH", str(folder))
    assert commit() == ""


def test_this_process_is_named_with_what_it_has_cost(float32_device):
    """Every part that a sceptic asks for, and times that only grow."""
    first = provenance_by_now("dco")
    sum(range(10**7))
    second = provenance_by_now("dco")
    assert first.code == code_digest("dco")
    assert (first.device, first.gpu) == ("cpu", "") and first.cpu
    assert first.threads == usable_cores()
    assert abs((datetime.now(timezone.utc) - first.date).total_seconds()) < 60
    assert 0 < first.cpu_seconds < second.cpu_seconds
    assert 0 < first.wall_seconds < second.wall_seconds
    assert Provenance.model_validate_json(first.model_dump_json()) == first


def test_a_run_in_parts_has_the_sum_of_their_times():
    """And the machine of the last part."""
    first = Provenance(code="a", cpu="old", wall_seconds=1.5, cpu_seconds=2.25)
    last = Provenance(code="a", cpu="new", wall_seconds=10.0, cpu_seconds=20.0)
    whole = last.after(first)
    assert (whole.wall_seconds, whole.cpu_seconds, whole.cpu) == (11.5, 22.25, "new")
    assert last.after(Provenance()) == last
