"""`morph run` and `morph rerun` as real processes: results, Ctrl-C, kills, resuming, refusals."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from morph_engine.metrics.chamfer import chamfer_metrics
from morph_engine.results.trajectory import Trajectory

MORPH = Path(sys.executable).with_name("morph")
FRAME_COUNT = 60
PLAIN = ["run", "sphere", "star"]
QUICK = ["--method", "dco", "--points-per-cell-edge", "1"]
SMALL = [*PLAIN, *QUICK, "--frames", str(FRAME_COUNT)]
PROMISED = {
    "s2t", "t2s", "two_sided", "hausdorff", "f1", "overlap_01", "many_to_one", "frames",
    "particle_count", "target_count", "wall_s", "cpu_s", "peak_rss_mb", "events",
}  # fmt: skip


def morph(*arguments, cwd):
    """Run the command and capture what it prints."""
    return subprocess.run(
        [MORPH, *map(str, arguments)], cwd=cwd, timeout=600, capture_output=True, text=True
    )


def start_and_wait_for(line_start, *arguments, cwd):
    """Start the command and return it once standard error has a line that begins so."""
    process = subprocess.Popen(
        [MORPH, *arguments], cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    for line in process.stderr:
        if line.startswith(line_start):
            return process
    raise AssertionError(f"the run ended without a line {line_start!r}")


def frames_of(path):
    """All frames of a result, shape [T, n, 3]."""
    with Trajectory(path) as result:
        return np.stack(list(result))


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """A complete run: its folder and its JSON."""
    folder = tmp_path_factory.mktemp("unbroken")
    outcome = morph(*SMALL, "--json", cwd=folder)
    assert outcome.returncode == 0, outcome.stderr
    return folder, json.loads(outcome.stdout), outcome.stderr


def test_json_has_what_scripts_were_promised(unbroken):
    """Standard output is one object with every promised key; progress went to standard error."""
    _, document, progress = unbroken
    assert document.keys() >= PROMISED
    assert document["frames"] == FRAME_COUNT
    assert document["cpu_s"] > 0 and document["wall_s"] > 0 and document["peak_rss_mb"] > 10
    assert sum(line.startswith("frame ") for line in progress.splitlines()) == FRAME_COUNT


def test_the_run_left_one_result_file_named_after_its_shapes(unbroken):
    """The result holds all frames and the numbers that were printed; nothing else is left."""
    folder, document, _ = unbroken
    assert [path.name for path in folder.iterdir()] == ["sphere-to-star.vtkhdf"]
    with Trajectory(folder / document["out"]) as result:
        assert (result.status, result.frame_count) == ("complete", FRAME_COUNT)
        assert result.particle_count == document["particle_count"]
        assert result.metrics_at(-1)["two_sided"] == document["two_sided"]


def test_the_morph_approaches_its_target(tmp_path):
    """Four frames of the default method bring the sphere most of the way to the star."""
    few = ["--points-per-cell-edge", "2", "--frames", "4"]
    document = json.loads(morph(*PLAIN, *few, "--json", cwd=tmp_path).stdout)
    with Trajectory(tmp_path / document["out"]) as result:
        last = result.metrics["two_sided"][-1]
        source, target = result.run.source_points, result.target_points
        first = chamfer_metrics(source, target, spacing=result.config.spacing)["two_sided"]
    assert last < 0.26 * first
    assert document["escaped"] == 0 and document["det_f_min"] > 0


def test_metrics_of_a_result_are_those_of_the_run(unbroken):
    """`morph metrics RESULT` measures against the run's own target."""
    folder, document, _ = unbroken
    measured = json.loads(morph("metrics", document["out"], "--json", cwd=folder).stdout)
    for name in ("s2t", "t2s", "two_sided", "hausdorff", "f1", "many_to_one", "iou"):
        # the run takes its distances from the device, in float32
        assert measured[name] == pytest.approx(document[name], rel=1e-5, abs=1e-3)


def test_rerun_repeats_the_run_from_its_file_alone(unbroken, tmp_path):
    """The same positions, with no mesh and no option given."""
    folder, document, _ = unbroken
    again = tmp_path / "again.vtkhdf"
    outcome = morph("rerun", folder / document["out"], "--out", again, "--json", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads(outcome.stdout)["difference"] == 0
    assert np.array_equal(frames_of(again), frames_of(folder / document["out"]))


def test_rerun_never_replaces_what_it_repeats(unbroken):
    """It would be compared with itself."""
    folder, document, _ = unbroken
    original = (folder / document["out"]).read_bytes()
    outcome = morph("rerun", document["out"], "--out", document["out"], "--force", cwd=folder)
    assert outcome.returncode == 2, outcome.stderr
    assert "would replace" in outcome.stderr
    assert (folder / document["out"]).read_bytes() == original


def test_ctrl_c_leaves_a_valid_partial_result_that_resume_completes(unbroken, tmp_path):
    """Exit status 130; --resume then ends bit for bit where the unbroken run does."""
    folder, document, _ = unbroken
    process = start_and_wait_for("frame 0 ", *SMALL, "--json", cwd=tmp_path)
    process.send_signal(signal.SIGINT)
    printed, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "--resume" in said and "Traceback" not in said
    partial = json.loads(printed)
    assert partial["interrupted"] and partial["frames"] >= 1
    result = tmp_path / document["out"]
    with Trajectory(result) as stopped:
        assert (stopped.status, stopped.frame_count) == ("partial", partial["frames"])

    assert morph(*SMALL, "--resume", cwd=tmp_path).returncode == 0
    assert np.array_equal(frames_of(result), frames_of(folder / document["out"]))
    assert [path.name for path in tmp_path.iterdir()] == [result.name]


def test_ctrl_c_without_json_says_what_there_is_and_how_to_continue(tmp_path):
    """How many frames are in which file; its quality is measured at the end of a run alone."""
    process = start_and_wait_for("frame 0 ", *SMALL, cwd=tmp_path)
    process.send_signal(signal.SIGINT)
    printed, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert re.search(r"^\d+ frames of .*: sphere-to-star\.vtkhdf$", printed, re.MULTILINE)
    assert "--resume" in said and "Traceback" not in said
    with Trajectory(tmp_path / "sphere-to-star.vtkhdf") as stopped:
        assert printed.startswith(f"{stopped.frame_count} frames ")


def test_a_killed_run_resumes_bit_for_bit(unbroken, tmp_path):
    """SIGKILL gives no chance to tidy up, and costs at most the frame in progress."""
    folder, document, _ = unbroken
    process = start_and_wait_for("frame 0 ", *SMALL, cwd=tmp_path)
    process.kill()
    process.communicate(timeout=120)
    refused = morph(*SMALL, cwd=tmp_path)
    assert refused.returncode == 2 and "--resume" in refused.stderr
    outcome = morph(*SMALL, "--resume", "--json", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert np.array_equal(
        frames_of(tmp_path / document["out"]), frames_of(folder / document["out"])
    )


def test_ctrl_c_before_the_first_frame_has_no_traceback(tmp_path):
    """While meshes are read and kernels compiled, Ctrl-C ends at once and says so."""
    process = subprocess.Popen(
        [MORPH, *SMALL], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Ctrl-C" in said and "Traceback" not in said


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--preset", "fsat"], ["fsat", "fast"]),
        (["--method", "joit"], ["joit", "joint"]),
        (["--set", "chamfer.weigt=5"], ["chamfer.weight"]),
        (
            ["--method", "joint", "--set", "chamfer.weight=-1"],
            ["chamfer.weight", "greater than or equal to 0"],
        ),
        (["--set", "chamfer.weight"], ["--set"]),
        (["--method", "joint", "--set", "time.dt=0.1"], ["time.dt", "stability limit"]),
        (["--frames", "0"], ["frames"]),
        (["--out", "nowhere/result.vtkhdf"], ["nowhere", "--out"]),
    ],
)
def test_bad_options_are_refused_with_cause_and_remedy(tmp_path, options, words):
    """Exit status 2, two sentences that name the culprit and the cure, and nothing left behind."""
    outcome = morph(*SMALL, *options, cwd=tmp_path)
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 2, outcome.stderr
    for word in words:
        assert word in outcome.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_mistake_in_the_method_is_named_before_a_missing_file(tmp_path):
    """What is typed wrong on the command line comes before what lies on the disk."""
    outcome = morph("run", "missing.obj", "star", "--method", "joit", cwd=tmp_path)
    assert outcome.returncode == 2
    assert "'joit'" in outcome.stderr and "'joint'" in outcome.stderr
    assert "missing.obj" not in outcome.stderr


def test_a_result_is_not_overwritten_unasked(tmp_path):
    """Another --out or --force is asked for, and the file stays as it was."""
    (tmp_path / "sphere-to-star.vtkhdf").write_text("precious")
    outcome = morph(*SMALL, cwd=tmp_path)
    assert outcome.returncode == 2 and "--force" in outcome.stderr
    assert (tmp_path / "sphere-to-star.vtkhdf").read_text() == "precious"
