"""Damaged meshes must be refused politely: feed random corruptions to `morph inspect`.

    python -m benchmarks.corruption --count 500 --seed 0

Each case is a real process. It may accept the file (exit 0) or refuse it (exit 2); anything else,
a traceback, more than 10 s or more than 1 GiB is a failure, and its file is kept. Seconds are the
smaller of clock and CPU time: other work on the machine inflates the one, threads the other.
"""

from __future__ import annotations

import argparse
import collections
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

SECONDS_LIMIT = 10.0
PATIENCE_SECONDS = 60.0
POLL_SECONDS = 0.01
MEGABYTES_LIMIT = 1024.0
ROOT = Path(__file__).resolve().parent.parent
Random = np.random.Generator

WEIRD_NUMBERS = (b"nan", b"inf", b"-inf", b"1e308", b"1e-320", b"-1", b"0", b"99999999999999999999")
WEIRD_BYTES = tuple(
    np.asarray(value, dtype).tobytes()
    for value, dtype in (
        (np.nan, "<f4"), (np.inf, "<f4"), (3e38, "<f4"), (-1, "<i4"), (2**31 - 1, "<i4"), (0, "<i4")
    )
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A damaged file and how it came about."""

    name: str
    suffix: str
    data: bytes


@dataclass(frozen=True)
class Outcome:
    """What `morph inspect` did with a case."""

    case: Case
    exit_status: int
    seconds: float
    megabytes: float
    message: str

    @property
    def failure(self) -> str:
        """Why this is not acceptable; empty if it is."""
        if self.exit_status == -signal.SIGKILL:
            return f"still running after {PATIENCE_SECONDS:.0f} s"
        if self.seconds > SECONDS_LIMIT:
            return f"took {self.seconds:.1f} s"
        if self.exit_status not in (0, 2):
            return f"exit status {self.exit_status}"
        if "Traceback" in self.message:
            return "traceback"
        return f"used {self.megabytes:.0f} MB" if self.megabytes > MEGABYTES_LIMIT else ""


def cases(count: int, seed: int) -> Iterator[Case]:
    """Make `count` damaged files, the same for the same seed."""
    random = np.random.default_rng(seed)
    for number in range(count):
        damage_mesh = _pick(random, MESH_DAMAGES)
        suffix, export = _pick(random, FORMATS)
        data = export(damage_mesh(_healthy(random), random))
        damage_file = _pick(random, FILE_DAMAGES)
        data = damage_file(data, random)
        if random.random() < 0.1:
            suffix = _pick(random, FORMATS)[0]
        name = f"{number:03d}-{damage_mesh.__name__}-{damage_file.__name__}".replace("_", "")
        yield Case(name, suffix, data)


def inspect(case: Case, folder: Path) -> Outcome:
    """Run `morph inspect` on a case in a process of its own and measure it."""
    path = folder / f"{case.name}.{case.suffix}"
    path.write_bytes(case.data)
    started = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "chamfer_morph", "inspect", str(path)],
            cwd=ROOT, stdout=output, stderr=subprocess.STDOUT,
        )  # fmt: skip
        timer = threading.Timer(PATIENCE_SECONDS, process.kill)
        timer.start()
        megabytes = 0.0
        while not (ended := os.wait4(process.pid, os.WNOHANG))[0]:
            megabytes = max(megabytes, _peak_megabytes(process.pid))
            time.sleep(POLL_SECONDS)
        _, status, usage = ended
        timer.cancel()
        clock_seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        message = output.read().decode(errors="replace").strip()
    if sys.platform == "darwin":
        megabytes = usage.ru_maxrss / 2**20
    seconds = min(clock_seconds, usage.ru_utime + usage.ru_stime)
    return Outcome(case, process.returncode, seconds, megabytes, message)


def _peak_megabytes(pid: int) -> float:
    """Most memory that a program has had at once so far [MB], on Linux.

    What the system says of an ended process counts its parent before it became that program, too.
    """
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0.0
    peaks = [int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")]
    return peaks[0] / 2**10 if peaks else 0.0


def _healthy(random: Random) -> trimesh.Trimesh:
    size = random.uniform(3, 12)
    return _pick(
        random,
        (
            partial(trimesh.creation.box, extents=(size, size, 1.3 * size)),
            partial(trimesh.creation.icosphere, subdivisions=1, radius=size),
            partial(trimesh.creation.torus, size, size / 3, major_sections=12, minor_sections=8),
        ),
    )()


def _pick(random: Random, options):
    return options[random.integers(len(options))]


# Damage to the mesh before it is written ----------------------------------------------------------


def _sound(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    return mesh


def _wrong_index(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    faces = np.array(mesh.faces)
    wrong = _pick(random, (-1, len(mesh.vertices), 2**31 - 1, -(2**31)))
    faces[random.integers(len(faces)), random.integers(3)] = wrong
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def _bad_vertex(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    vertices = np.array(mesh.vertices)
    bad = _pick(random, (np.nan, np.inf, -np.inf, 1e9, 1e30, 1e300, 1e-300))
    vertices[random.integers(len(vertices)), random.integers(3)] = bad
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def _rescaled(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    scale = 10.0 ** random.uniform(-30, 30) * _pick(random, (np.ones(3), np.array([1, 1, 1e-9])))
    return trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)


def _faces_missing(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    kept = random.random(len(mesh.faces)) < random.random()
    return trimesh.Trimesh(mesh.vertices, mesh.faces[kept], process=False)


def _faces_repeated(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    chosen = random.integers(len(mesh.faces), size=10 ** random.integers(1, 5))
    return trimesh.Trimesh(mesh.vertices, mesh.faces[chosen], process=False)


def _faces_turned(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    turned = random.random(len(mesh.faces)) < random.random()
    faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def _vertices_shuffled(mesh: trimesh.Trimesh, random: Random) -> trimesh.Trimesh:
    return trimesh.Trimesh(random.permutation(mesh.vertices), mesh.faces, process=False)


MESH_DAMAGES: tuple[Callable[[trimesh.Trimesh, Random], trimesh.Trimesh], ...] = (
    _sound, _sound, _sound, _sound, _sound, _wrong_index, _bad_vertex, _rescaled,
    _faces_missing, _faces_repeated, _faces_turned, _vertices_shuffled,
)  # fmt: skip


# Writing; trimesh itself would mend some of the damage --------------------------------------------


def _obj(mesh: trimesh.Trimesh) -> bytes:
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices.tolist())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
    return (vertices + faces).encode()


def _off(mesh: trimesh.Trimesh) -> bytes:
    vertices = "".join(f"{x} {y} {z}\n" for x, y, z in mesh.vertices.tolist())
    faces = "".join(f"3 {a} {b} {c}\n" for a, b, c in mesh.faces.tolist())
    return f"OFF\n{len(mesh.vertices)} {len(mesh.faces)} 0\n{vertices}{faces}".encode()


def _ply(mesh: trimesh.Trimesh, *, text: bool) -> bytes:
    kind = "ascii" if text else "binary_little_endian"
    header = (
        f"ply\nformat {kind} 1.0\nelement vertex {len(mesh.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if text:
        return header + _off(mesh).split(b"\n", 2)[2]
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, mesh.faces
    with np.errstate(over="ignore"):
        return header + mesh.vertices.astype("<f4").tobytes() + faces.tobytes()


def _stl(mesh: trimesh.Trimesh, *, text: bool) -> bytes:
    corners = mesh.vertices[mesh.faces % len(mesh.vertices)]
    if text:
        facets = "".join(
            "facet normal 0 0 0\nouter loop\n"
            + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
            + "endloop\nendfacet\n"
            for triangle in corners.tolist()
        )
        return f"solid damaged\n{facets}endsolid damaged\n".encode()
    facets = np.zeros(
        len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("a", "<u2")]
    )
    with np.errstate(over="ignore"):
        facets["corners"] = corners
    return bytes(80) + np.uint32(len(corners)).tobytes() + facets.tobytes()


def _glb(mesh: trimesh.Trimesh) -> bytes:
    with np.errstate(over="ignore", invalid="ignore"):
        return trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh))


FORMATS: tuple[tuple[str, Callable[[trimesh.Trimesh], bytes]], ...] = (
    ("obj", _obj),
    ("off", _off),
    ("ply", partial(_ply, text=True)),
    ("ply", partial(_ply, text=False)),
    ("stl", partial(_stl, text=True)),
    ("stl", partial(_stl, text=False)),
    ("glb", _glb),
    ("glb", _glb),
)


# Damage to the bytes of the file ------------------------------------------------------------------


def _intact(data: bytes, random: Random) -> bytes:
    return data


def _empty(data: bytes, random: Random) -> bytes:
    return _pick(random, (b"", b"\n\n", bytes(100)))


def _truncated(data: bytes, random: Random) -> bytes:
    return data[: random.integers(len(data))]


def _flipped(data: bytes, random: Random) -> bytes:
    flipped = np.frombuffer(data, np.uint8).copy()
    at = random.integers(len(data), size=2 ** random.integers(0, 7))
    flipped[at] ^= 1 << random.integers(0, 8, at.size).astype(np.uint8)
    return flipped.tobytes()


def _header_flipped(data: bytes, random: Random) -> bytes:
    return _flipped(data[:200], random) + data[200:]


def _cut(data: bytes, random: Random) -> bytes:
    start, stop = np.sort(random.integers(len(data) + 1, size=2))
    return data[:start] + data[stop:]


def _repeated(data: bytes, random: Random) -> bytes:
    start, stop = np.sort(random.integers(len(data) + 1, size=2))
    return data[:stop] + data[start:stop] * random.integers(1, 4) + data[stop:]


def _noise(data: bytes, random: Random) -> bytes:
    at = random.integers(len(data) + 1)
    return data[:at] + random.bytes(random.integers(1, 2000)) + data[at:]


def _weird_numbers(data: bytes, random: Random) -> bytes:
    """Overwrite words of text by odd numbers, or aligned bytes by odd binary numbers."""
    if b"\n" not in data[:60]:
        weird = bytearray(data)
        for at in 4 * random.integers(len(data) // 4, size=random.integers(1, 6)):
            weird[at : at + 4] = _pick(random, WEIRD_BYTES)
        return bytes(weird)
    lines = data.split(b"\n")
    for row in random.integers(len(lines), size=random.integers(1, 6)):
        words = lines[row].split(b" ")
        words[random.integers(len(words))] = _pick(random, WEIRD_NUMBERS)
        lines[row] = b" ".join(words)
    return b"\n".join(lines)


def _numbers_in_header(data: bytes, random: Random) -> bytes:
    """Let a text header, as of PLY, OFF and glTF, declare other numbers than it should."""
    head, tail = data[:1200], data[1200:]
    digits = [i for i, byte in enumerate(head) if chr(byte).isdigit()]
    if not digits:
        return _weird_numbers(data, random)
    at = _pick(random, digits)
    return (
        head[:at]
        + _pick(random, (b"0", b"7", b"-1", b"4294967295", b"1e18"))
        + head[at + 1 :]
        + tail
    )


FILE_DAMAGES: tuple[Callable[[bytes, Random], bytes], ...] = (
    _intact, _intact, _empty, _truncated, _truncated, _flipped, _flipped, _header_flipped, _cut,
    _repeated, _noise, _weird_numbers, _weird_numbers, _numbers_in_header, _numbers_in_header,
)  # fmt: skip


def main() -> int:
    """Run the cases and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="corruption-"))
    with ThreadPoolExecutor(options.workers) as pool:
        outcomes = []
        for outcome in pool.map(
            partial(inspect, folder=folder), cases(options.count, options.seed)
        ):
            outcomes.append(outcome)
            path = folder / f"{outcome.case.name}.{outcome.case.suffix}"
            if outcome.failure:
                print(f"{outcome.failure}: {path}\n{outcome.message[-2000:]}", flush=True)
            else:
                path.unlink()
    statuses = collections.Counter(outcome.exit_status for outcome in outcomes)
    failures = sum(bool(outcome.failure) for outcome in outcomes)
    print(
        f"{len(outcomes)} cases, seed {options.seed}: {failures} failures, "
        f"{statuses[0]} accepted, {statuses[2]} refused; slowest "
        f"{max(outcome.seconds for outcome in outcomes):.1f} s, largest "
        f"{max(outcome.megabytes for outcome in outcomes):.0f} MB"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
