"""Make the pictures of the documentation again.

    python -m docs.pictures --meshes DIR            # all of them, about four minutes
    python -m docs.pictures page                    # those of the web page alone
    python -m docs.pictures page --views job keys   # some of them
    python -m docs.pictures looks                   # the six looks, in the page and by morph render
    python -m docs.pictures gallery --to DIR        # twelve morphs, a sheet and their videos

`page` and `looks` need chromium and the built page (make page); `morphs` needs the paper's meshes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from docs.pictures.gallery import gallery
from docs.pictures.looks import looks
from docs.pictures.morphs import morph_pictures
from docs.pictures.page import page_pictures
from docs.pictures.theory import theory_pictures

IMAGES = Path(__file__).resolve().parents[1] / "images"
GROUPS = ("page", "looks", "morphs", "theory")


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.pictures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "groups", nargs="*", help=f"of {', '.join(GROUPS)}; all if none is named; or gallery"
    )
    parser.add_argument("--meshes", type=Path, help="folder with sphere.obj and bunny.obj")
    parser.add_argument("--views", nargs="+", default=[], help="those of the page alone")
    parser.add_argument("--to", type=Path, default=IMAGES, help="folder of the pictures")
    arguments = parser.parse_args()
    wanted = arguments.groups or GROUPS
    if unknown := set(wanted) - {*GROUPS, "gallery"}:
        parser.error(f"There are no pictures called {', '.join(sorted(unknown))}.")
    if "morphs" in wanted and arguments.meshes is None:
        parser.error("The pictures of morphs need --meshes, a folder with the paper's meshes.")
    arguments.to.mkdir(parents=True, exist_ok=True)
    if "theory" in wanted:
        theory_pictures(arguments.to)
    if "morphs" in wanted:
        morph_pictures(arguments.to, arguments.meshes)
    if "gallery" in wanted:
        gallery(arguments.to)
    if "looks" in wanted:
        looks(arguments.to)
    if "page" in wanted:
        page_pictures(arguments.to / "page", arguments.views)


if __name__ == "__main__":
    main()
