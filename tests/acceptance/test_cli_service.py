"""The service commands of `morph` as users meet them: a real service, processes and signals."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import psutil
import pytest

from chamfer_morph.client import MorphClient
from morph_engine.machine_cores import usable_cores
from morph_engine.results.trajectory import Trajectory

ENGINE = "chamfer_morph.worker.engine_process"
MORPH = Path(sys.executable).with_name("morph")
SMALL = ["--points-per-cell-edge", "2", "--frames", "2"]
LONG = ["--points-per-cell-edge", "2", "--frames", "300"]
BOX = """\
v -8 -8 -8
v 8 -8 -8
v 8 8 -8
v -8 8 -8
v -8 -8 8
v 8 -8 8
v 8 8 8
v -8 8 8
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")


def environment(server=None):
    """This process's environment without settings of a service, and with an address of one."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
    plain["MORPH_WARM_ENGINES"] = "false"
    return plain | ({"MORPH_SERVER": server} if server else {})


@contextmanager
def running(*arguments, **variables):
    """A `morph` command that runs until it is told to end, with its children."""
    process = subprocess.Popen([MORPH, *map(str, arguments)], env=environment() | variables)
    family = psutil.Process(process.pid)
    try:
        yield process
    finally:
        descendants = family.children(recursive=True) if family.is_running() else []
        process.terminate()
        try:
            process.wait(20)
        finally:
            for one in (family, *descendants):
                if one.is_running():
                    one.kill()
            process.wait()


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """The address of a service with one worker, started with `morph serve`."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    data_dir = tmp_path_factory.mktemp("service")
    with running("serve", "--port", port, "--workers", 1, "--data-dir", data_dir) as process:
        server = f"http://127.0.0.1:{port}"
        with MorphClient(server) as client:
            deadline = time.monotonic() + 300
            while process.poll() is None and time.monotonic() < deadline:
                try:
                    client.shapes()
                    break
                except Exception:
                    time.sleep(0.1)
        yield server


@pytest.fixture
def morph(service, tmp_path):
    """Runs a command against the service, and captures what it prints."""

    def run(*arguments, server=service, key=None):
        return subprocess.run(
            [MORPH, *map(str, arguments)],
            cwd=tmp_path,
            env=environment(server) | ({"MORPH_KEY": key} if key else {}),
            timeout=600,
            capture_output=True,
            text=True,
        )

    return run


@pytest.fixture
def long_job(morph, service, tmp_path):
    """The id of a running job that would last for minutes, and the process that watches it."""
    submitted = morph("submit", "sphere", "torus", *LONG, "--quiet")
    assert submitted.returncode == 0, submitted.stderr
    job_id = submitted.stdout.strip()
    watching = subprocess.Popen(
        [MORPH, "watch", job_id], cwd=tmp_path, env=environment(service),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    for line in watching.stderr:
        if line.startswith("frame 0 "):
            break
    yield job_id, watching
    watching.kill()
    watching.communicate()
    morph("cancel", job_id)


def assert_refused(outcome, *words, status=2):
    """The exit status, two lines (cause and remedy), no traceback, and each word said."""
    assert outcome.returncode == status, outcome.stderr
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 2, outcome.stderr
    assert all(line.endswith((".", "?")) for line in lines), outcome.stderr
    for word in words:
        assert word in outcome.stderr


def test_a_mesh_is_submitted_watched_shown_and_fetched(morph, service, tmp_path):
    """From a file on this machine to a result on this machine, and from Python to an array."""
    (tmp_path / "box.obj").write_text(BOX)
    outcome = morph("submit", "box.obj", "star", *SMALL, "--name", "first", "--watch", "--json")
    assert outcome.returncode == 0, outcome.stderr
    job = json.loads(outcome.stdout)
    assert (job["state"], job["name"], job["source_name"]) == ("succeeded", "first", "box.obj")
    assert sum(line.startswith("frame ") for line in outcome.stderr.splitlines()) == 2

    again = morph("watch", job["id"])
    quality, *rest = again.stdout.splitlines()
    assert again.returncode == 0 and "of the target is filled" in quality
    assert len(rest) == 3 and rest[-1].endswith(f"morph fetch {job['id']}")
    shown = morph("show", job["id"])
    assert "box.obj to star" in shown.stdout and "succeeded" in shown.stdout
    listed = morph("jobs", "--state", "succeeded", "--method", "flow")
    assert job["id"] in listed.stdout and "2/2" in listed.stdout

    assert morph("fetch", job["id"]).returncode == 0
    with Trajectory(tmp_path / "box-to-star.vtkhdf") as result:
        last = result.positions(-1)
        assert (result.status, result.frame_count) == ("complete", 2)
        assert result.metrics_at(-1)["two_sided"] == job["outcome"]["metrics"]["two_sided"]
    assert_refused(morph("fetch", job["id"]), "box-to-star.vtkhdf", "--force")
    assert_refused(morph("fetch", job["id"], "--out", "nowhere/x"), "nowhere")
    forced = json.loads(morph("fetch", job["id"], "--force", "--json").stdout)
    assert forced["size_bytes"] == job["outcome"]["size_bytes"]

    with MorphClient(service) as client:
        frame = client.frame(job["id"], 1)
        assert frame.dtype == np.float32 and np.array_equal(frame, last)
        assert [row["frame"] for row in client.metrics(job["id"])] == [0, 1]
        assert client.config(job["id"])["frames"] == 2
        assert [mesh.name for mesh in client.meshes()] == ["box.obj"]


def test_a_job_goes_through_several_shapes(morph, service, tmp_path):
    """Files and built-in shapes, one job of two legs, whose frames say to which they belong."""
    (tmp_path / "box.obj").write_text(BOX)
    outcome = morph(
        "submit", "sphere", "box.obj", "sphere", "--method", "dco", "--watch", "--json", *SMALL
    )
    assert outcome.returncode == 0, outcome.stderr
    job = json.loads(outcome.stdout)["id"]
    with MorphClient(service) as client:
        found = client.job(job)
        assert (found.source_name, found.via_names, found.target_name) == (
            "sphere", ["box.obj"], "sphere",
        )  # fmt: skip
        assert (found.progress.frame, found.progress.frames, found.outcome.frames) == (4, 4, 4)
        frames = [event.data for event in client.events(job) if event.type == "frame"]
        assert [(data["leg"], data["legs"]) for data in frames] == [(0, 2), (0, 2), (1, 2), (1, 2)]
    shown = morph("show", job)
    assert "sphere to box.obj to sphere" in shown.stdout
    assert morph("fetch", job).returncode == 0
    with Trajectory(tmp_path / "sphere-to-box-to-sphere.vtkhdf") as result:
        assert result.legs.tolist() == [0, 0, 1, 1]
        assert result.status == "complete"


def test_ctrl_c_leaves_a_watched_job_alone_which_then_is_cancelled(morph, long_job, tmp_path):
    """130 after Ctrl-C, 1 for a job that was cancelled; its frames can be fetched, it can go on."""
    job_id, watching = long_job
    watching.send_signal(signal.SIGINT)
    _, said = watching.communicate(timeout=600)
    assert watching.returncode == 130
    assert "the job continues" in said and f"morph watch {job_id}" in said
    assert json.loads(morph("show", job_id, "--json").stdout)["state"] == "running"
    assert_refused(morph("retry", job_id), "running")

    cancelled = morph("cancel", job_id)
    assert cancelled.returncode == 0 and cancelled.stdout.split() == [job_id, "cancelled"]
    ended = morph("watch", job_id)
    assert ended.returncode == 1 and "cancelled" in ended.stdout

    assert wait_for(lambda: morph("fetch", job_id).returncode == 0)
    with Trajectory(tmp_path / "sphere-to-torus-partial.vtkhdf") as partial:
        assert partial.frame_count >= 1

    resumed = morph("resume", job_id)
    assert resumed.returncode == 0, resumed.stderr
    assert_refused(morph("delete", job_id), "cannot be deleted")
    assert morph("cancel", job_id).returncode == 0
    assert wait_for(lambda: morph("delete", job_id).returncode == 0)
    assert_refused(morph("show", job_id), job_id)


def test_a_repeated_submission_is_one_job(morph):
    """The same key is the same job; with another request it is refused."""
    command = ["submit", "sphere", "star", *SMALL, "--idempotency-key", "once", "--quiet"]
    first, second = morph(*command), morph(*command)
    assert first.returncode == second.returncode == 0
    assert first.stdout == second.stdout and len(first.stdout.split()) == 1
    assert_refused(morph(*command, "--seed", "7"), "Idempotency-Key")
    morph("cancel", first.stdout.strip())


def test_a_sweep_computes_every_combination(morph):
    """Two targets, one table; a single line says how it went."""
    outcome = morph(
        "sweep", "--sources", "sphere", "--targets", "star,torus", "--frames", "1",
        "--points-per-cell-edge", "1", "--watch", "--json",
    )  # fmt: skip
    assert outcome.returncode == 0, outcome.stderr
    sweep = json.loads(outcome.stdout)
    assert [(row["target"], row["state"]) for row in sweep["rows"]] == [
        ("star", "succeeded"),
        ("torus", "succeeded"),
    ]
    shown = morph("sweep", sweep["id"])
    assert all(word in shown.stdout for word in ("star", "torus", "two_sided", "2 succeeded"))
    assert_refused(morph("sweep", "--sources", "sphere"), "--targets")
    assert_refused(morph("sweep", "--sources", "a", "--targets", "b", "--seeds", "x"), "--seeds")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["submit", "sphere", "star", "--preset", "fsat"], ["fsat", "fast"]),
        (["submit", "sphere", "star", "--set", "chamfer.weigt=5"], ["chamfer.weight"]),
        (["submit", "sphere", "star", "--set", "chamfer.weight"], ["--set"]),
        (["submit", "sphere", "star", "--frames", "0"], ["frames"]),
        (["submit", "sphere", "stra"], ["stra"]),
        (["submit", "missing.obj", "star"], ["missing.obj"]),
        (["show", "nonsense"], ["nonsense"]),
        (["watch", "nonsense"], ["nonsense"]),
        (["fetch", "nonsense"], ["nonsense"]),
        (["jobs", "--server", "localhost"], ["localhost", "http://"]),
        (["worker", "--slots", "1", "--gpus", "all"], ["--slots", "--gpus"]),
    ],
)
def test_what_is_refused_says_why_and_what_to_do(morph, command, words):
    """Exit status 2 and two sentences, whether this program or the service refuses."""
    assert_refused(morph(*command), *words)


def test_refusals_of_some_jobs_under_json(morph):
    """One object with what was done and what was not."""
    outcome = morph("cancel", "nonsense", "nothing", "--json")
    assert outcome.returncode == 2
    document = json.loads(outcome.stdout)
    assert document["jobs"] == [] and [each["job"] for each in document["errors"]] == [
        "nonsense",
        "nothing",
    ]


def test_without_a_service_the_exit_status_is_3(morph):
    """And the remedy says how to start one."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nobody = f"http://127.0.0.1:{free.getsockname()[1]}"
    outcome = morph("jobs", "--json", server=nobody)
    assert_refused(outcome, nobody, "morph serve", status=3)
    assert set(json.loads(outcome.stdout)["error"]) == {"cause", "remedy"}


def test_keys_are_made_used_and_deleted(morph):
    """As soon as there is a key, one is needed; the secret is all that standard output has."""
    admin = morph("keys", "create", "boss", "--scope", "admin").stdout.strip()
    try:
        assert_refused(morph("jobs"), "MORPH_KEY")
        reader = morph("keys", "create", "reader", "--scope", "read", "--json", key=admin)
        secret = json.loads(reader.stdout)["secret"]
        assert morph("jobs", key=secret).returncode == 0
        assert_refused(morph("submit", "sphere", "star", key=secret))
        listed = morph("keys", "list", key=admin).stdout
        assert "boss" in listed and "reader" in listed and secret not in listed
        assert morph("keys", "delete", "reader", key=admin).returncode == 0
        assert_refused(morph("jobs", key=secret))
    finally:
        assert morph("keys", "delete", "boss", key=admin).returncode == 0
    assert morph("jobs").returncode == 0


def test_a_worker_is_paused_and_let_go(morph):
    """The list says so."""
    (worker,) = json.loads(morph("workers", "list", "--json").stdout)["workers"]
    assert worker["alive"] and not worker["paused"]
    assert "paused" in morph("workers", "pause", worker["id"]).stdout
    assert "paused" in morph("workers", "list").stdout
    assert "paused" not in morph("workers", "unpause", worker["id"]).stdout
    assert_refused(morph("workers", "pause", "nobody"), "nobody")


def test_the_own_queue_is_paused_and_a_job_put_first(morph):
    """Paused jobs wait; the one named is before those that were submitted earlier."""
    assert "paused" in morph("queue", "pause").stdout
    jobs = [morph("submit", "sphere", "star", "--quiet").stdout.strip() for _ in range(2)]
    assert json.loads(morph("queue", "show", "--json").stdout)["queued"] == 2
    assert morph("next", jobs[1]).stdout.split() == [jobs[1], "queued"]
    assert json.loads(morph("show", jobs[0], "--json").stdout)["paused"]
    assert morph("cancel", *jobs).returncode == 0
    assert "paused" not in morph("queue", "unpause").stdout


def test_help_needs_neither_http_nor_the_schemas():
    """Help does not pay for the imports of the service commands."""
    code = (
        "import sys, chamfer_morph.cli.app as c\n"
        "c.app(['submit', '--help'], standalone_mode=False)\n"
        "sys.exit(' '.join({'httpx', 'chamfer_morph.schemas', 'numpy'} & set(sys.modules)))"
    )
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert outcome.stderr.strip() == ""


def test_the_client_needs_no_server_or_database():
    """What talks to the service by HTTP loads nothing of what serves it."""
    code = "import sys, chamfer_morph.client.client; "
    code += "sys.exit(' '.join({'dbos', 'fastapi', 'sqlalchemy', 'taichi'} & set(sys.modules)))"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert outcome.stderr.strip() == ""


def test_workers_that_die_are_started_again(tmp_path):
    """`morph worker` replaces a killed slot, and takes its workers along when it ends."""
    with running("worker", "--slots", 2, "--data-dir", tmp_path) as process:
        parent = psutil.Process(process.pid)
        assert wait_for(lambda: len(parent.children()) == 2)
        first = parent.children()[0]
        first.kill()
        assert wait_for(lambda: len({each.pid for each in parent.children()} - {first.pid}) == 2)
        workers = parent.children()
        process.terminate()
        assert process.wait(15) == 0
        assert not any(each.is_running() for each in workers)


def test_workers_that_cannot_start_end_the_command(tmp_path):
    """Which says why: a misspelt setting, or a slot that is taken."""
    wrong = subprocess.run(
        [MORPH, "worker"], env=environment() | {"MORPH_WRKERS": "1"}, timeout=600,
        capture_output=True, text=True,
    )  # fmt: skip
    assert_refused(wrong, "MORPH_WRKERS", "MORPH_WORKERS")
    with running("worker", "--data-dir", tmp_path):
        assert wait_for(lambda: [*tmp_path.glob("locks/*-slot0")])
        taken = subprocess.run(
            [MORPH, "worker", "--data-dir", tmp_path], env=environment(), timeout=600,
            capture_output=True, text=True,
        )  # fmt: skip
        assert_refused(taken, "Another worker runs", "--first-slot")


def test_workers_of_a_machine_share_its_cores(tmp_path):
    """Two slots have half of the cores each."""
    warm = {"MORPH_WARM_ENGINES": "true"}
    with running("worker", "--slots", 2, "--data-dir", tmp_path, **warm) as process:
        parent = psutil.Process(process.pid)
        threads = {}

        def engines_are_there():
            for each in parent.children(recursive=True):
                with suppress(psutil.NoSuchProcess):  # a short one
                    command = each.cmdline()
                    if ENGINE in command:
                        threads[each.pid] = int(command[command.index(ENGINE) + 1])
            return len(threads) >= 2

        assert wait_for(engines_are_there)
    assert {*threads.values()} == {max(1, usable_cores() // 2)}


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel ends orphans on Linux only")
def test_workers_do_not_outlive_the_command_that_keeps_them(tmp_path):
    """Even after SIGKILL: their slots are free for the next one."""
    with running("worker", "--data-dir", tmp_path) as process:
        parent = psutil.Process(process.pid)
        assert wait_for(lambda: len(parent.children()) == 1)
        workers = parent.children()
        process.kill()
        assert wait_for(lambda: not any(each.is_running() for each in workers))


def wait_for(condition, seconds=600.0):
    """Whether a condition comes true in time."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True
