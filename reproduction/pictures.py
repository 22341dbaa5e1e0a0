"""Draw the pictures of docs/propositions.md into the folder that is given."""

from __future__ import annotations

import argparse
from pathlib import Path

from chamfer_morph.reproduction import planar, propositions

DOTS_PER_INCH = 120


def main() -> None:
    """Write `propositions.png` and `circle-to-star.png`; about a minute."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the pictures go")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    propositions.figure().savefig(folder / "propositions.png", dpi=DOTS_PER_INCH)
    planar.figure(planar.run_all()).savefig(folder / "circle-to-star.png", dpi=DOTS_PER_INCH)


if __name__ == "__main__":
    main()
