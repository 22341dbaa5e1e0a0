"""Measure a method on 29 pairs of meshes: the table of docs/method.md, and a sheet of pictures.

    python -m docs.pictures.paths --meshes DIR --to FOLDER                  # every pair
    python -m docs.pictures.paths sphere-cow --meshes DIR --to FOLDER --set method.memory=10
    python -m docs.pictures.paths --sheet SHEET.webp --to FOLDER --beside OTHER_FOLDER

Results and numbers are kept in FOLDER; pairs that are there already are not computed again. A sheet
has twelve pairs of results, those of the other folder below.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from docs.pictures.gallery import QUALITY, row_of_surfaces
from morph_engine.comparison import measure_path
from morph_engine.morphing import morph
from morph_engine.presets import configure
from morph_engine.results.trajectory import Trajectory

SHAPES = ("sphere", "bunny", "duck", "cow", "teapot")
PAIRS = (
    *(f"{a}-{b}" for a in SHAPES for b in SHAPES if a != b),
    "sphere-dragon",
    "sphere-heart",
    "sphere-letter_C",
    "sphere-letter_E",
    "sphere-letter_V",
    "beast-gingerbread",
    "gingerbread-beast",
    "cow-cow_bent",
    "duck-duck_y90",
)
"""The paper's twenty and nine more, each the names of two meshes."""

TITLES = {"cow_bent": "Cow bent", "duck_y90": "Duck turned by 90°"}

SHOWN = (
    "sphere-bunny",
    "sphere-teapot",
    "bunny-duck",
    "duck-cow",
    "cow-teapot",
    "teapot-bunny",
    "sphere-dragon",
    "sphere-letter_E",
    "sphere-letter_V",
    "beast-gingerbread",
    "cow-cow_bent",
    "duck-duck_y90",
)
"""Pairs of the sheet."""

COLUMNS = (
    "pair | he | area over schedule | volume over schedule | pieces, Euler number beyond the ends "
    "| D2min [h²] | kept | gap: 1 %; least [h] | t→s, its floor [dx] "
    "| IoU with the mesh; at its volume | density 5–95 % | surface to mesh [dx], normals [°] "
    "| CPU [s]"
)


def measured(result: Path) -> dict[str, float]:
    """All numbers of the table, and the spacing at the end over h."""
    with Trajectory(result) as run:
        growth = float(np.cbrt(run.run.ratio))
        return {"he": growth, **measure_path(run)}


def _title(name: str) -> str:
    return TITLES.get(name) or name.removeprefix("letter_").capitalize()


def row(pair: str, m: dict[str, float]) -> str:
    """A line of the table."""
    return (
        f"| {' → '.join(_title(name) for name in pair.split('-'))} | {m['he']:.2f} "
        f"| {m['area_min']:.2f}–{m['area_max']:.2f} | {m['volume_min']:.3f}–{m['volume_max']:.3f} "
        f"| {m['more_pieces']:.0f}, {m['more_euler']:.0f} | {m['d2_min']:.2f} | {m['kept']:.2f} "
        f"| {m['gap_p01']:.2f}; {m['gap_min']:.2f} "
        f"| {m['dense_t2s']:.3f}, {m['dense_floor']:.3f} "
        f"| {m['mesh_iou']:.3f}; {m['mesh_iou_level']:.3f} "
        f"| {m['density_p05']:.2f}–{m['density_p95']:.2f} "
        f"| {m['surface_mean']:.3f}, {m['normal_mean']:.1f} | {m['cpu_seconds']:.0f} |"
    )


def measure_pair(
    pair: str, meshes: Path, folder: Path, settings: dict[str, Any]
) -> dict[str, float]:
    """Compute a pair, or read what was computed before, and measure it."""
    known, result = folder / f"{pair}.json", folder / f"{pair}.vtkhdf"
    if known.exists():
        numbers: dict[str, float] = json.loads(known.read_text())
        return numbers
    config = configure("fast", settings)
    source, target = (meshes / f"{name}.obj" for name in pair.split("-"))
    began = time.process_time()
    for _ in morph(source, target, config, threads=1, out=result, overwrite=True):
        pass
    numbers = {"cpu_seconds": time.process_time() - began, **measured(result)}
    known.write_text(json.dumps(numbers, indent=1))
    return numbers


def sheet(path: Path, folders: Sequence[Path]) -> None:
    """Draw twelve pairs, six frames each, those of the folders below each other."""
    rows = [
        row_of_surfaces(folder / f"{pair}.vtkhdf", f"{pair}, {folder.name}")
        for pair in SHOWN
        for folder in folders
    ]
    Image.fromarray(np.concatenate(rows)).save(path, quality=QUALITY)


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.pictures.paths",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("pairs", nargs="*", help="like sphere-cow; all if none is named")
    parser.add_argument("--meshes", type=Path, default="meshes", help="folder with sphere.obj, ...")
    parser.add_argument("--to", type=Path, required=True, help="folder of the results")
    parser.add_argument("--set", action="append", default=[], help="a setting, KEY=VALUE")
    parser.add_argument("--sheet", type=Path, help="draw this picture instead")
    parser.add_argument("--beside", type=Path, help="folder of other results of the same pairs")
    arguments = parser.parse_args()
    if arguments.sheet:
        sheet(arguments.sheet, [f for f in (arguments.to, arguments.beside) if f])
        return
    arguments.to.mkdir(parents=True, exist_ok=True)
    settings = dict(setting.split("=", 1) for setting in arguments.set)
    print(f"| {COLUMNS} |\n{'|---' * (COLUMNS.count('|') + 1)}|")
    for pair in arguments.pairs or PAIRS:
        print(row(pair, measure_pair(pair, arguments.meshes, arguments.to, settings)), flush=True)


if __name__ == "__main__":
    main()
