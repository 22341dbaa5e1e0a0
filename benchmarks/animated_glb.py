"""How large the animated GLB of a default job is: `python -m benchmarks.animated_glb`.

Three pairs with the default settings and 40 frames, one of which changes its topology; two minutes
each. Needs node and the packages of the page (make page) for the Khronos validator. The exit status
is the number of bars that are missed.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.record import machine

PAIRS = (("sphere", "star"), ("heart", "teapot"), ("sphere", "torus"))
MOST = 20e6
"""Size of a file [bytes]."""

MODULES = Path(__file__).resolve().parents[1] / "server" / "web" / "node_modules"
VALIDATE = """
const validator = require(process.argv[1]);
validator.validateBytes(new Uint8Array(require("fs").readFileSync(process.argv[2])))
  .then((report) => console.log(JSON.stringify(report.issues)));
"""


def main() -> None:
    """Compute the pairs, print a row for each, and count what is missed."""
    node = shutil.which("node") or sys.exit("There is no node.")
    sys.stdout.write(f"{machine()}\n\npair             frames  vertices       MB  errors\n")
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        for source, target in PAIRS:
            path = _animated(Path(folder), source, target)
            frames, vertices = _targets(path)
            size = path.stat().st_size
            command = [node, "-e", VALIDATE, MODULES / "gltf-validator", path]
            printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            errors = json.loads(printed)["numErrors"]
            counts = " + ".join(str(count) for count in vertices)
            pair = f"{source} to {target}"
            sys.stdout.write(f"{pair:15}  {frames:6}  {counts:13} {size / 1e6:5.1f}  {errors:6}\n")
            missed += (size > MOST) + (errors > 0) + (frames != 40)
    sys.exit(missed)


def _animated(folder: Path, source: str, target: str) -> Path:
    """The animated GLB of a default job."""
    morph = Path(sys.executable).with_name("morph")
    result, path = folder / f"{source}-{target}.vtkhdf", folder / f"{source}-{target}.glb"
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
    main()
