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
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from docs.pictures.gallery import QUALITY, row_of_surfaces
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.surface_reconstruction import reconstruct_surface, surface_euler
from morph_engine.methods.transport import ease
from morph_engine.metrics.body import count_pieces, measure_body
from morph_engine.metrics.independent import mesh_metrics, surface_metrics
from morph_engine.metrics.path import (
    gap_metrics,
    geodesic_distortion,
    neighbor_metrics,
    over_schedule,
)
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

BODIES = 9
"""Frames, evenly spaced, of which area, volume and Euler number are taken."""

COLUMNS = (
    "pair | he | area over schedule | volume over schedule | pieces, Euler number beyond the ends "
    "| D2min [h²] | kept | gap: 1 %; least [h] | t→s, its floor [dx] "
    "| IoU with the mesh; at its volume | density 5–95 % | surface to mesh [dx], normals [°] "
    "| CPU [s]"
)


def measured(result: Path) -> dict[str, float]:
    """All numbers of the table, by the worst of the frames where they are those of a frame.

    h of a frame is the spacing of as many particles in a volume that goes linearly from that of the
    source to that of the target.
    """
    with Trajectory(result) as run:
        config, spacing = run.config, run.config.spacing
        frames = [run.run.source_points, *run]
        rest = getattr(config.method, "rest", 0.0)
        ratio = len(run.target_points) / len(run.run.source_points)
        mesh = _in_grid_units(run)
        correction = run.metrics.get("correction", np.zeros(len(run)))
    count = len(frames) - 1
    shares = np.array([ease(i / ((1 - rest) * count)) for i in range(count + 1)])
    apart = spacing * np.cbrt(1 - shares + shares * ratio)
    some = np.linspace(0, count, BODIES).round().astype(int)
    bodies = {i: measure_body(frames[i], apart[i]) for i in some}
    area = over_schedule([body.area for body in bodies.values()], shares[some])
    volume = over_schedule([body.volume for body in bodies.values()], shares[some])
    gaps = [gap_metrics(frame, h) for frame, h in zip(frames, apart, strict=True)]
    path = np.linalg.norm(np.diff(frames, axis=0), axis=2).sum(axis=0).mean()
    return {
        "he": float(apart[-1] / spacing),
        "area_min": float(area.min()),
        "area_max": float(area.max()),
        "volume_min": float(volume.min()),
        "volume_max": float(volume.max()),
        "more_pieces": _beyond([count_pieces(f, h) for f, h in zip(frames, apart, strict=True)]),
        "more_euler": _beyond([surface_euler(frames[i], apart[i]) for i in some]),
        **neighbor_metrics(frames[0], frames[-1], spacing),
        "gap_p01": min(gap["gap_p01"] for gap in gaps),
        "gap_min": min(gap["gap_min"] for gap in gaps),
        "geodesic": geodesic_distortion(frames[0], frames[-1], spacing),
        "settled": float(correction.sum() / path),
        **mesh_metrics(frames[-1], mesh, float(apart[-1])),
        **surface_metrics(reconstruct_surface(frames[-1], float(apart[-1])), mesh),
    }


def _in_grid_units(run: Trajectory) -> Mesh:
    mesh, to_grid = run.target, np.linalg.inv(run.transform)
    assert isinstance(mesh, Mesh)
    return replace(mesh, vertices=mesh.vertices @ to_grid[:3, :3].T + to_grid[:3, 3])


def _beyond(counts: Sequence[int]) -> int:
    """How far any count is outside the range of the first and the last."""
    low, high = sorted((counts[0], counts[-1]))
    return int(max(max(counts) - high, low - min(counts)))


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
