"""Pictures of morphs: the README's film strip, ParaView's view, surfaces, and who fills evenly."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from morph_engine.morphing import morph
from morph_engine.presets import configure
from morph_engine.rendering.colormap import DIVERGING
from morph_engine.rendering.pictures import Camera, look, picture
from morph_engine.results.selection import Selection, Snapshot
from morph_engine.results.trajectory import Trajectory

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
METHODS = ("joint", "transport", "flow")
SIZE = (720, 720)
DENSITIES = (0.0, 2.0)
VIEW = look(azimuth=110.0, up="z")
"""The paper's bunny stands on z, and is seen from +x."""


def morph_pictures(folder: Path, meshes: Path) -> None:
    """Morph the paper's sphere into its bunny, by `joint`, `transport` and `flow`, and draw them.

    Args:
        folder: Where the pictures are written.
        meshes: Folder with sphere.obj and bunny.obj.
    """
    with tempfile.TemporaryDirectory() as scratch:
        results = {method: Path(scratch) / f"{method}.vtkhdf" for method in METHODS}
        for method, path in results.items():
            config = configure("fast", {"method": method})
            frames = morph(meshes / "sphere.obj", meshes / "bunny.obj", config, out=path)
            print(f"{method}: {len(list(frames))} frames")
        film = ("--frames", "12", "20", "26", "39", "--up", "z", "--azimuth", "110")
        _script("film_strip.py", results["flow"], folder / "morph.png", *film)
        _script(
            "vtk_picture.py", results["flow"], folder / "paraview.png", *_labels(results["flow"])
        )
        _densities(results, folder / "density.png")
        _surface(results["flow"], folder / "surface.png")


def _labels(result: Path) -> tuple[str, ...]:
    """Options of the script: colours around the volume that the target leaves each particle."""
    with Trajectory(result) as trajectory:
        ratio = trajectory.run.ratio
    title = f"Sphere to bunny by flow, last frame; the bunny has {ratio:.2f} times the volume"
    middle = "--middle", f"{ratio:.2f}"
    return ("--up", "z", "--title", title, "--label", "det F [ratio]", *middle)


def _script(name: str, result: Path, picture: Path, *options: str) -> None:
    subprocess.run([sys.executable, EXAMPLES / name, result, picture, *options], check=True)


def _densities(results: dict[str, Path], path: Path) -> None:
    """Local density at the last frame, method beside method."""
    figure = Figure(figsize=(4.2 * len(results) + 0.8, 4.4), layout="constrained")
    axes = figure.subplots(1, len(results), squeeze=False)[0]
    for panel, (method, result) in zip(axes, results.items(), strict=True):
        with Trajectory(result) as trajectory:
            selection = _last(trajectory, fields=("density",))
            (snapshot,) = selection.snapshots()
        panel.imshow(
            picture(
                snapshot.vertices,
                spacing=snapshot.spacing,
                values=snapshot.fields["density"],
                limits=DENSITIES,
                diverging=True,
                view=Camera.facing(snapshot.vertices, VIEW, SIZE),
                size=SIZE,
            )
        )
        panel.set(title=method, xticks=[], yticks=[])
        panel.spines[:].set_visible(False)
    scale = ScalarMappable(Normalize(*DENSITIES), DIVERGING)
    figure.colorbar(scale, ax=list(axes), shrink=0.8, label="density over the target's")
    figure.savefig(path, dpi=110)


def _surface(result: Path, path: Path) -> None:
    """Particles of the last frame, and the surface around them."""
    with Trajectory(result) as trajectory:
        selections = [_last(trajectory), _last(trajectory, surface=True)]
        shown = [snapshot for selection in selections for snapshot in selection.snapshots()]
    view = Camera.facing(shown[0].vertices, VIEW, SIZE)
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    for panel, snapshot in zip(figure.subplots(1, 2), shown, strict=True):
        panel.imshow(_plain(snapshot, view))
        panel.set_axis_off()
    figure.savefig(path, dpi=110)


def _plain(snapshot: Snapshot, view: Camera) -> NDArray[np.uint8]:
    return picture(
        snapshot.vertices, spacing=snapshot.spacing, faces=snapshot.faces, view=view, size=SIZE
    )


def _last(
    trajectory: Trajectory, *, surface: bool = False, fields: tuple[str, ...] = ()
) -> Selection:
    frame = trajectory.frame_count - 1
    return Selection(trajectory, (frame,), surface=surface, units="grid", fields=fields)
