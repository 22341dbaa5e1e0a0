"""Compare methods on the same two shapes: numbers side by side, and where the particles lie.

    python examples/compare_methods.py --methods transport,joint,dco --frames 12

Which numbers compare what, and which of them have floors, is told in docs/metrics.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from morph_engine import configure, morph
from morph_engine.rendering.pictures import picture

NUMBERS = ("two_sided", "iou", "many_to_one", "overlap_h10", "rho_p95")


def main() -> None:
    """Read the command line, run each method, and print and draw what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", default="sphere")
    parser.add_argument("--target", default="star")
    parser.add_argument("--methods", default="transport,joint,dco")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--points", type=int, default=2, help="particles per grid cell edge")
    parser.add_argument("--picture", type=Path, default=Path("methods.png"))
    arguments = parser.parse_args()

    panels = []
    print(f"{'method':14}" + "".join(f"{name:>14}" for name in NUMBERS))
    for method in arguments.methods.split(","):
        settings = {
            "method": method,
            "frames": arguments.frames,
            "sampling.points_per_cell_edge": arguments.points,
        }
        config = configure("fast", settings)
        *_, last = morph(arguments.source, arguments.target, config)
        assert np.isfinite(last.positions).all(), f"{method} should keep every particle."
        print(f"{method:14}" + "".join(f"{last.metrics[name]:14.4f}" for name in NUMBERS))
        panels.append(picture(last.positions, spacing=config.spacing, size=(480, 360)))
    Image.fromarray(np.hstack(panels)).save(arguments.picture)
    print(f"Drawn, in the same order: {arguments.picture}.")


if __name__ == "__main__":
    main()
