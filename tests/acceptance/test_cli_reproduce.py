"""`morph reproduce` as a user meets it: real runs, signals, a failed run, a real service."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from chamfer_morph.client import MorphClient
from morph_engine.code_digest import code_digest
from morph_engine.files import acquire
from morph_engine.results.spool import finished_frames, spool_path
from morph_engine.results.trajectory import Trajectory
from tests.patience import PATIENCE

MORPH = Path(sys.executable).with_name("morph")
RUNS = ("trial-dco", "trial-joint")

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")


def environment():
    """This process's environment without settings of the project."""
    return {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}


def command(*arguments, results):
    """The command line of a trial."""
    return [MORPH, "reproduce", *map(str, arguments), "--results", str(results)]


def reproduce(*arguments, results):
    """Run the command to its end and capture what it prints."""
    return subprocess.run(
        command(*arguments, results=results),
        env=environment(), timeout=600, capture_output=True, text=True,
    )  # fmt: skip


def result_path(results, run_id):
    """Where the frames of a run lie."""
    return results / "runs" / f"{run_id}.vtkhdf"


def record_path(results, run_id):
    """Where the record of a run lies."""
    return results / "runs" / f"{run_id}.json"


def provenance_of(results, run_id):
    """What the record of a run says of who computed it."""
    return json.loads(record_path(results, run_id).read_text())["provenance"]


def frames_of(results, run_id):
    """All frames of a run, shape [T, n, 3]."""
    with Trajectory(result_path(results, run_id)) as result:
        assert result.status == "complete"
        return np.stack(list(result))


def assert_same_bits(results, unbroken):
    """Both runs of a trial equal those of an unbroken one."""
    for run_id in RUNS:
        np.testing.assert_array_equal(frames_of(results, run_id), frames_of(unbroken, run_id))


def wait_for(condition, seconds=600):
    """Wait until a condition holds; fails if it does not in time."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """The folder of a trial that nothing disturbed."""
    results = tmp_path_factory.mktemp("unbroken")
    outcome = reproduce("trial", "--jobs", 2, results=results)
    assert outcome.returncode == 0, outcome.stderr
    assert "2 runs to compute" in outcome.stderr
    assert "Trial of the machinery" in outcome.stdout and "report.html" in outcome.stdout
    return results


def test_a_trial_leaves_tables_figures_and_a_report_and_is_not_computed_twice(unbroken):
    """Everything is in one folder; the second command only reads it."""
    assert (unbroken / "tables" / "trial.csv").is_file()
    assert {path.suffix for path in (unbroken / "figures").iterdir()} == {".png", ".svg"}
    report = (unbroken / "report.html").read_text(encoding="utf-8")
    assert "data:image/png" in report and "figure is missing" not in report

    written = [result_path(unbroken, run_id).stat().st_mtime_ns for run_id in RUNS]
    outcome = reproduce("trial", "--json", results=unbroken)
    assert outcome.returncode == 0, outcome.stderr
    assert "0 runs to compute, 2 already computed" in outcome.stderr
    numbers = json.loads(outcome.stdout)["tables"]["trial"]["numbers"]
    assert {row["run_ids"] for row in numbers} == set(RUNS)
    assert written == [result_path(unbroken, run_id).stat().st_mtime_ns for run_id in RUNS]


@pytest.mark.parametrize("is_torn", [False, True], ids=["other code", "torn"])
def test_a_run_that_nobody_knows_the_code_of_is_computed_again(unbroken, tmp_path, is_torn):
    """The command says so, and how to keep the run; a torn record cannot be kept."""
    results = tmp_path / "results"
    shutil.copytree(unbroken, results)
    path = record_path(results, RUNS[0])
    text = path.read_text().replace(code_digest("dco"), "0" * 64)
    path.write_text(text[:100] if is_torn else text)
    written = result_path(results, RUNS[0]).stat().st_mtime_ns
    if not is_torn:
        outcome = reproduce("trial", "--any-code", results=results)
        assert "0 runs to compute, 2 already computed" in outcome.stderr
        assert "000000000000" in (results / "report.md").read_text(encoding="utf-8")
        assert result_path(results, RUNS[0]).stat().st_mtime_ns == written
    outcome = reproduce("trial", results=results)
    assert outcome.returncode == 0, outcome.stderr
    assert "1 runs to compute, 1 already computed" in outcome.stderr
    assert ("--any-code" in outcome.stderr) is not is_torn
    assert result_path(results, RUNS[0]).stat().st_mtime_ns != written
    assert provenance_of(results, RUNS[0])["code"] == code_digest("dco")
    assert_same_bits(results, unbroken)


def test_ctrl_c_and_kill_cost_nothing_but_the_frame_in_progress(unbroken, tmp_path):
    """After both the same command ends bit for bit where the unbroken one does.

    What the parts cost is summed.
    """
    spent = 0.0
    for send, frames in ((signal.SIGINT, 3), (signal.SIGKILL, 6)):
        process = subprocess.Popen(
            command("trial", "--jobs", 1, results=tmp_path), env=environment(),
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        path = result_path(tmp_path, RUNS[1])  # the costlier one comes first
        wait_for(lambda path=path, frames=frames: finished_frames(path) >= frames)
        engines = psutil.Process(process.pid).children()
        process.send_signal(send)
        _, said = process.communicate(timeout=120)
        if send == signal.SIGINT:
            assert process.returncode == 130 and "Repeat the command" in said
        assert psutil.wait_procs(engines, timeout=PATIENCE)[1] == []
        assert spool_path(path).is_dir() and not path.exists()
        assert provenance_of(tmp_path, RUNS[1])["cpu_seconds"] > spent
        spent = provenance_of(tmp_path, RUNS[1])["cpu_seconds"]

    outcome = reproduce("trial", "--jobs", 2, results=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert_same_bits(tmp_path, unbroken)
    assert provenance_of(tmp_path, RUNS[1])["cpu_seconds"] > spent


def test_a_run_that_fails_is_told_and_the_others_go_on(unbroken, tmp_path):
    """Exit status 1, the cause in the table and on standard error, everything else as ever."""
    runs = tmp_path / "runs"
    runs.mkdir()
    for suffix in (".json", ".vtkhdf"):
        (runs / f"{RUNS[0]}{suffix}").write_bytes(
            (unbroken / "runs" / f"{RUNS[0]}{suffix}").read_bytes()
        )
    spool = spool_path(result_path(tmp_path, RUNS[1]))
    spool.mkdir()
    with acquire(spool / "lock"):  # as if another process were writing the run
        outcome = reproduce("trial", results=tmp_path)
    assert outcome.returncode == 1
    assert f"{RUNS[1]} failed: Another process is writing" in outcome.stderr
    assert "failed" in outcome.stdout and "Without Joint." in outcome.stdout
    assert "Another process is writing" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["sphere", "--meshes", "nowhere"], ["bunny.obj", "Stanford", "--meshes"]),
     (["spehre"], ["spehre", "'sphere'"])],
)  # fmt: skip
def test_what_cannot_be_reproduced_is_refused_at_once(tmp_path, arguments, words):
    """Exit status 2 and two sentences: what is missing, what to do."""
    outcome = reproduce(*arguments, results=tmp_path / "results")
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 2
    for word in words:
        assert word in outcome.stderr
    assert not (tmp_path / "results").exists()


def test_without_a_table_there_is_a_list_of_them(tmp_path):
    """With what each costs."""
    listed = reproduce(results=tmp_path).stdout
    for word in ("regularisers", "Tables 5 and 9", "ablation", "planar"):
        assert word in listed


@pytest.mark.faults
def test_a_service_computes_the_same_and_each_run_once(unbroken, tmp_path):
    """Submitted, watched and fetched; a repeated command meets the jobs of the first one."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = f"http://127.0.0.1:{port}"
    service = subprocess.Popen(
        [MORPH, "serve", "--port", str(port), "--workers", "2", "--data-dir", tmp_path / "data"],
        env=environment() | {"MORPH_WARM_ENGINES": "false"}, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    family = psutil.Process(service.pid)
    try:
        with MorphClient(server) as client:
            wait_for(lambda: answers(client))
            for attempt in ("first", "second"):
                results = tmp_path / attempt
                outcome = reproduce("trial", "--server", server, results=results)
                assert outcome.returncode == 0, outcome.stderr
                assert_same_bits(results, unbroken)
                for run_id in RUNS:
                    known = provenance_of(results, run_id)
                    assert known["code"] == code_digest(run_id.partition("-")[2])
                    assert known["device"] and known["date"] and known["cpu_seconds"] > 0
                assert {job.name for job in client.jobs()} == set(RUNS)
                assert len(list(client.jobs())) == len(RUNS)
    finally:
        descendants = family.children(recursive=True)
        service.terminate()
        try:
            service.wait(20)
        finally:
            for each in (family, *descendants):
                if each.is_running():
                    each.kill()
            service.wait()


def answers(client):
    """Tell whether the service is up."""
    try:
        client.shapes()
    except Exception:
        return False
    return True
