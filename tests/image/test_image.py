"""The container image computes and exports as no root, and writes to its data directory alone."""

from __future__ import annotations

import os
import platform
import socket
import subprocess
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.image

ENGINE = os.environ.get("CONTAINER_ENGINE", "docker")
IMAGE = "morph"
LARGEST = 900_000_000
"""What the image may take unpacked [bytes]."""

SECRET = uuid.uuid4().hex
SMALL = ("--points-per-cell-edge", "1", "--frames", "2")


def run_engine(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the container engine to its end."""
    return subprocess.run(
        [ENGINE, *arguments], capture_output=True, text=True, check=False, timeout=600
    )


def restrictions() -> list[str]:
    """A root that is read-only, /tmp included where the engine mounts one, and no rights at all."""
    options = ["--read-only", "--cap-drop=ALL", "--security-opt=no-new-privileges"]
    return options + (["--read-only-tmpfs=false"] if "podman" in ENGINE else [])


def run_image(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the image to its end, with options before the command and its arguments."""
    return run_engine("run", "--rm", *restrictions(), *arguments)


@dataclass(frozen=True)
class Service:
    """A container with `morph serve`."""

    name: str
    port: int

    def run(self, *command: str) -> str:
        """Run a command in it; returns what it prints."""
        outcome = run_engine("exec", self.name, *command)
        assert outcome.returncode == 0, (command, outcome.stdout, outcome.stderr)
        return outcome.stdout

    def morph(self, *arguments: str) -> str:
        """Run `morph` in it, as a caller of its API."""
        server = f"MORPH_SERVER=http://127.0.0.1:{self.port}"
        return self.run("env", server, f"MORPH_KEY={SECRET}", "morph", *arguments)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """The image as it starts by default, with a key from a file."""
    key = tmp_path_factory.mktemp("secret") / "admin_key"
    key.write_text(SECRET)
    for path in (key, key.parent):
        path.chmod(0o755)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    name = f"morph-test-{uuid.uuid4().hex[:8]}"
    started = run_engine(
        "run", "--detach", "--name", name, *restrictions(), "--network=host",
        "--volume", f"{key}:/run/admin_key:ro", "--env=MORPH_ADMIN_KEY_FILE=/run/admin_key",
        f"--env=MORPH_PORT={port}", IMAGE,
    )  # fmt: skip
    assert started.returncode == 0, started.stderr
    try:
        deadline = time.monotonic() + 300
        while "(Ctrl-C stops it)" not in run_engine("logs", name).stderr:
            assert time.monotonic() < deadline, run_engine("logs", name)
            time.sleep(0.5)
        yield Service(name, port)
    finally:
        run_engine("rm", "--force", "--volumes", name)


def test_its_size() -> None:
    """Extras for videos, USD and object stores included."""
    size = int(run_engine("image", "inspect", "--format={{.Size}}", IMAGE).stdout)
    assert size < LARGEST


def test_what_it_may_do(service: Service) -> None:
    """It is no root, and nothing can be written but the data directory."""
    assert service.run("id", "--user").strip() == "1000"
    assert "CapEff:\t0000000000000000" in service.run("cat", "/proc/self/status")
    places = "/ /tmp /var/tmp /opt/morph /data"
    writable = f"for place in {places}; do test -w $place && echo $place; done; true"
    assert service.run("sh", "-c", writable).split() == ["/data"]


def test_a_machine_that_has_what_it_needs(service: Service) -> None:
    """`morph doctor` finds no fault, and computes a tiny morph."""
    assert "libX11.so.6" in service.run("morph", "doctor")


def test_a_job_and_its_exports(service: Service) -> None:
    """Computed by the service, made into a video and a USD file by it and by commands on a file."""
    job = service.morph("submit", "sphere", "star", *SMALL, "--quiet").strip()
    service.morph("watch", job)
    service.morph("fetch", job, "--out", "/data/job.vtkhdf")
    for result, name in ((job, "service"), ("/data/job.vtkhdf", "file")):
        for ending, beginning in (("mp4", b"ftyp"), ("usdc", b"PXR-USDC")):
            out = f"/data/{name}.{ending}"
            surface = ("--surface",) if ending == "usdc" else ()
            service.morph("export", result, *surface, "--out", out, "--quiet")
            head = service.run("head", "--bytes=12", out)
            assert beginning.decode() in head, head


def test_without_a_key_it_says_how_to_give_one() -> None:
    """It listens to other machines, so that it does not start."""
    refused = run_image(IMAGE)
    assert refused.returncode == 2
    assert "MORPH_ADMIN_KEY" in refused.stderr


def test_a_system_without_a_library(tmp_path: Path) -> None:
    """The error names the library that Taichi loads, and its package."""
    empty = tmp_path / "empty"
    empty.touch()
    library = f"/usr/lib/{platform.machine()}-linux-gnu/libX11.so.6"
    failed = run_image(
        "--volume", f"{empty}:{library}:ro", IMAGE,
        "morph", "run", "sphere", "star", *SMALL, "--quiet", "--out", "/data/a.vtkhdf",
    )  # fmt: skip
    assert failed.returncode != 0
    assert "apt-get install libx11-6" in failed.stderr.replace("\n", " ")
