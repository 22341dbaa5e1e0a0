"""How large the animated GLB of a default job is: `python -m benchmarks.animated_glb [--record]`.

Three pairs with the default settings and 40 frames, one of which changes its topology; two minutes
each. Needs node and the packages of the page (make page) for the Khronos validator. The exit status
is the number of bars that are missed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks import history
from benchmarks.record import machine
from benchmarks.service.measurement import Measurement, counted, table

PAIRS = (("sphere", "star"), ("heart", "teapot"), ("sphere", "torus"))
FRAMES = 40
MOST = 20.0
"""Size of a file [MB]."""

MODULES = Path(__file__).resolve().parents[1] / "server" / "web" / "node_modules"
VALIDATE = """
const validator = require(process.argv[1]);
validator.validateBytes(new Uint8Array(require("fs").readFileSync(process.argv[2])))
  .then((report) => console.log(JSON.stringify(report.issues)));
"""


def main() -> int:
    """Compute the pairs and print what their files are like.

    Returns:
        Exit status: the number of figures on the wrong side of their limit.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.animated_glb", description=__doc__)
    parser.add_argument("--record", action="store_true", help="add it to results/history.jsonl")
    options = parser.parse_args()
    node = shutil.which("node") or sys.exit("There is no node.")
    before = machine()
    figures, errors, missing = [], 0, 0
    with tempfile.TemporaryDirectory() as folder:
        for source, target in PAIRS:
            path = _animated(Path(folder), source, target)
            frames, vertices = _targets(path)
            counts = " and ".join(f"{count} vertices" for count in vertices)
            size = path.stat().st_size / 1e6
            figures.append(Measurement(f"animated GLB, {path.stem}", size, MOST, "MB", counts))
            errors += _errors(path, node)
            missing += FRAMES - frames
    figures.append(counted("animated GLB: errors of the Khronos validator", errors, 0))
    figures.append(counted("animated GLB: missing frames", missing, 0))
    if options.record:
        history.record(figures)
    print(f"{before}\n\n{table(figures)}")
    return sum(figure.missed for figure in figures)


def _errors(path: Path, node: str) -> int:
    """Errors that the Khronos validator finds in a file."""
    command = [node, "-e", VALIDATE, MODULES / "gltf-validator", path]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return int(json.loads(printed)["numErrors"])


def _animated(folder: Path, source: str, target: str) -> Path:
    """The animated GLB of a default job."""
    morph = Path(sys.executable).with_name("morph")
    result, path = folder / f"{source} to {target}.vtkhdf", folder / f"{source} to {target}.glb"
    subprocess.run([morph, "run", source, target, "--out", result, "--quiet"], check=True)
    subprocess.run([morph, "export", result, "-o", path, "--tracked"], check=True)
    return path


def _targets(path: Path) -> tuple[int, list[int]]:
    """Frames that a file has, and the vertices of each of its meshes, the same in all frames."""
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    accessors = document["accessors"]
    frames, vertices = 1, []  # that in which a mesh takes over is one of both
    for mesh in document["meshes"]:
        (primitive,) = mesh["primitives"]
        count = accessors[primitive["attributes"]["POSITION"]]["count"]
        assert all(accessors[one["POSITION"]]["count"] == count for one in primitive["targets"])
        vertices.append(count)
        frames += len(primitive["targets"])
    return frames, vertices


if __name__ == "__main__":
    sys.exit(main())
