"""What a machine needs to compute morphs and to serve them, looked at one thing after the other."""

from __future__ import annotations

import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from chamfer_morph.cli.tables import format_size
from morph_engine.child_process import describe_exit, python_command
from morph_engine.errors import ExtraError, MorphError
from morph_engine.system_libraries import LIBRARIES, installation, missing_libraries

if TYPE_CHECKING:
    from chamfer_morph.worker.settings import Settings

PACKAGES = ("taichi", "numpy", "scipy", "trimesh", "h5py")
SERVICE_PACKAGES = ("fastapi", "dbos")
"""Those of the extra `service`, which may be absent."""

LEAST_MEMORY, LEAST_DISK = 1 << 30, 1 << 30
"""What a job of 38 000 particles takes with its result, rounded up [bytes]."""

LARGEST_CLOCK_DIFFERENCE = 5.0
"""From the database's clock, by which jobs have their deadlines [s]."""

CONNECTIONS_PER_PROCESS = 3


@dataclass(frozen=True)
class Finding:
    """What was found of one thing.

    Attributes:
        subject: The thing.
        verdict: "ok"; "warning" where something works, but not as well as it might; "fault".
        text: What was found.
        remedy: What to do about it; empty where it is well.
    """

    subject: str
    verdict: Literal["ok", "warning", "fault"]
    text: str
    remedy: str = ""


def examine(*, compute: bool = True) -> Iterator[Finding]:
    """Look at everything, the quick things first.

    Args:
        compute: Whether to compute a tiny morph, too, which takes some seconds.

    Yields:
        Findings as they come.
    """
    yield check_software()
    yield check_libraries()
    yield check_memory()
    try:
        yield from check_service()
    except ExtraError as error:
        yield Finding("service", "ok", f"It is not installed. {error.remedy}")
    if compute:
        yield check_morph()


def check_service() -> Iterator[Finding]:
    """What the service needs beside what a run does, by its MORPH_* variables.

    Raises:
        ExtraError: It is not installed.
    """
    from chamfer_morph.worker.settings import load_settings

    yield check_network()
    yield check_files()
    try:
        settings = load_settings()
    except MorphError as error:
        yield Finding("settings", "fault", error.cause, error.remedy)
        return
    yield check_disk(settings.data_dir)
    yield from check_privacy(settings.data_dir)
    checks: list[tuple[str, Callable[[Settings], Finding]]] = [("database", check_database)]
    if settings.object_store:
        checks.append(("object store", check_object_store))
    for subject, check in checks:
        try:
            yield check(settings)
        except MorphError as error:
            yield Finding(subject, "fault", error.cause, error.remedy)


def check_software() -> Finding:
    """Versions, as a report of a fault needs them."""
    installed = (*PACKAGES, *filter(find_spec, SERVICE_PACKAGES))
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in installed)
    ours = f"chamfer-morph {metadata.version('chamfer-morph')}"
    return Finding("software", "ok", f"{ours}, Python {platform.python_version()}, {versions}")


def check_libraries() -> Finding:
    """Libraries of the system without which Taichi cannot be loaded."""
    if missing := missing_libraries():
        text = f"{', '.join(missing)} cannot be loaded."
        return Finding("libraries", "fault", text, installation(missing))
    return Finding("libraries", "ok", ", ".join(LIBRARIES) or "none needed")


def check_memory() -> Finding:
    """Memory and cores that a job may use."""
    from morph_engine.machine_cores import usable_cores
    from morph_engine.machine_memory import free_memory, total_memory

    free = free_memory()
    text = f"{format_size(free)} free of {format_size(total_memory())}, {usable_cores()} cores"
    if free < LEAST_MEMORY:
        return Finding("memory", "warning", text, "Free some memory: a job takes half a gigabyte.")
    return Finding("memory", "ok", text)


def check_disk(data_dir: Path) -> Finding:
    """Whether the data directory can be written, and has room."""
    place = next(
        path for path in (data_dir.absolute(), *data_dir.absolute().parents) if path.exists()
    )
    try:
        with tempfile.TemporaryFile(dir=place) as file:
            file.write(bytes(1 << 16))
    except OSError as error:
        return Finding(
            "disk", "fault", f"{data_dir} cannot be written to ({error.strerror or error}).",
            "Free some space, or choose another MORPH_DATA_DIR.",
        )  # fmt: skip
    free = shutil.disk_usage(place).free
    text = f"{format_size(free)} free for {data_dir}"
    if free < LEAST_DISK:
        return Finding("disk", "warning", text, "Free some space: a result takes 24 MB.")
    return Finding("disk", "ok", text)


def check_privacy(data_dir: Path) -> Iterator[Finding]:
    """Whether other users of this machine may look into the data directory, which has secrets."""
    if os.name == "posix" and data_dir.exists() and data_dir.stat().st_mode & 0o077:
        yield Finding(
            "privacy", "warning", f"{data_dir} is open to other users of this machine.",
            f"chmod 700 {data_dir}",
        )  # fmt: skip


def check_network() -> Finding:
    """Whether processes that read uploads can be kept from the network."""
    command = python_command("chamfer_morph.worker.sandbox.network")
    if sys.platform != "linux":
        text = "Processes that read uploads have network access: it can be blocked only on Linux."
        return Finding(
            "network",
            "warning",
            text,
            "Use a firewall to keep the service from reaching other machines.",
        )
    if subprocess.run(command, check=False).returncode:
        return Finding(
            "network", "warning", "Processes that read uploads have network access.",
            "Allow user namespaces (sysctl kernel.unprivileged_userns_clone=1, or a seccomp "
            "profile that permits unshare), or block it by a network policy.",
        )  # fmt: skip
    return Finding("network", "ok", "Processes that read uploads have no network access.")


def check_files() -> Finding:
    """Whether processes that read uploads can be kept from the files of others."""
    command = python_command("chamfer_morph.worker.sandbox.landlock")
    status = subprocess.run(command, check=False).returncode
    if sys.platform == "linux" and status == -signal.SIGSYS:
        return Finding(
            "files", "fault",
            "A system call filter forbids Landlock: it kills every process that reads uploads.",
            "Allow landlock_create_ruleset, landlock_add_rule and landlock_restrict_self in the "
            "filter, with systemd in SystemCallFilter=.",
        )  # fmt: skip
    if status:
        return Finding(
            "files", "warning",
            "Processes that read uploads can read every file that the service can.",
            "Use Linux 5.13 or newer with Landlock enabled (in `lsm=` of the kernel command line).",
        )  # fmt: skip
    return Finding(
        "files", "ok", "Processes that read uploads can read only the files of their task."
    )


def check_database(settings: Settings) -> Finding:
    """Whether the database answers, how soon, whether its clock agrees, and its connections.

    Raises:
        DatabaseUnavailableError: It does not answer.
    """
    import sqlalchemy as sa

    from chamfer_morph.worker.dbos_adapter import check_reachable, database

    if not settings.on_postgres and not (settings.data_dir / "morph.sqlite").exists():
        return Finding("database", "ok", "SQLite, which `morph serve` will create")
    check_reachable(settings)
    engine = database(settings)
    try:
        with engine.connect() as connection:
            began = time.perf_counter()
            connection.execute(sa.text("select 1"))
            answer = f"answers in {1000 * (time.perf_counter() - began):.1f} ms"
            if not settings.on_postgres:
                return Finding("database", "ok", f"SQLite, {answer}")
            query = "select extract(epoch from clock_timestamp()), current_setting(:name)"
            row = connection.execute(sa.text(query), {"name": "max_connections"}).one()
            ahead, connections = float(row[0]) - time.time(), int(row[1])
    finally:
        engine.dispose()
    text = f"Postgres, {answer}, {connections} connections, clocks differ by {abs(ahead):.1f} s"
    if abs(ahead) > LARGEST_CLOCK_DIFFERENCE:
        return Finding(
            "database", "warning", text, "Synchronise the clocks of both machines by NTP."
        )
    if settings.workers * CONNECTIONS_PER_PROCESS > connections:
        return Finding("database", "warning", text, "Raise max_connections, or run fewer workers.")
    return Finding("database", "ok", text)


def check_object_store(settings: Settings) -> Finding:
    """Whether the object store answers, and refuses to write what has changed.

    Raises:
        MorphError: It cannot be used.
    """
    from chamfer_morph.worker.object_store.bucket import Bucket, ObjectChangedError

    bucket = Bucket.open(settings.object_store)
    began = time.perf_counter()
    key = f"probe/{os.urandom(8).hex()}"
    etag = bucket.replace(key, b"1", None)
    seconds = time.perf_counter() - began

    def writes(condition: str | None) -> bool:
        try:
            bucket.replace(key, os.urandom(8), condition)
        except ObjectChangedError:
            return False
        return True

    try:
        if not writes(etag):
            fault = "It refuses to replace an object by its ETag, so no job could go on."
        elif writes(etag):
            fault = "It ignores If-Match, so two workers could overwrite the same job."
        elif writes(None):
            fault = "It ignores If-None-Match, so two workers could claim the same job."
        else:
            return Finding("object store", "ok", f"writes in {1000 * seconds:.0f} ms")
    finally:
        bucket.delete([key])
    remedy = "Choose a store that supports conditional writes."
    return Finding("object store", "fault", fault, remedy)


def check_morph() -> Finding:
    """Whether a tiny morph can be computed here, and on which device."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result.vtkhdf"
        began = time.perf_counter()
        outcome = subprocess.run(
            [*python_command("chamfer_morph"), "run", "sphere", "torus", "--frames", "2",
             "--points-per-cell-edge", "1", "--quiet", "--out", str(out)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        seconds = time.perf_counter() - began
        if outcome.returncode or not out.is_file():
            last = outcome.stderr.strip() or describe_exit(outcome.returncode)
            return Finding("morph", "fault", last, "Report it together with the lines above.")
    return Finding("morph", "ok", f"two small frames in {seconds:.1f} s on {_device()}")


def _device() -> str:
    """Where runs compute on this machine unless they are told otherwise."""
    from morph_engine.backend import available_devices
    from morph_engine.results.provenance import cpu_name, gpu_name

    device = next(name for name in available_devices() if name != "vulkan")
    name = {"cpu": cpu_name, "cuda": gpu_name}.get(device, str)()
    return f"{device} ({name})" if name else device
