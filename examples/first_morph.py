"""A first morph: two shapes in, a result, a surface and a video out.

    python examples/first_morph.py --source sphere --target star --frames 20

The result opens in ParaView, the surface in Blender, the video anywhere.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from morph_engine import configure, morph
from morph_engine.export import export
from morph_engine.rendering.pictures import video


def main() -> None:
    """Read the command line and do all of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", default="sphere", help="a built-in shape, or a mesh file")
    parser.add_argument("--target", default="star", help="what it is to become")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--points", type=int, default=2, help="particles per grid cell edge")
    parser.add_argument("--folder", type=Path, default=Path("first-morph"))
    arguments = parser.parse_args()

    arguments.folder.mkdir(parents=True, exist_ok=True)
    result = arguments.folder / "morph.vtkhdf"
    settings = {"frames": arguments.frames, "sampling.points_per_cell_edge": arguments.points}
    config = configure("fast", settings)
    distances = []
    for frame in morph(arguments.source, arguments.target, config, out=result, overwrite=True):
        distances.append(frame.metrics["two_sided"])
        print(f"frame {frame.index:2}  Chamfer distance {distances[-1]:.3f} dx")
    assert distances[-1] <= distances[0], "The morph should end nearer to the target."

    surface = export(result, arguments.folder / "last.glb", "glb", surface=True)
    animation = video(result, arguments.folder / "morph.gif", field="displacement", size=(480, 360))
    print(f"Written: {result}, {surface}, {animation}.")


if __name__ == "__main__":
    main()
