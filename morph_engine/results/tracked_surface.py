"""The surface of a result as a mesh whose triangles stay the same from frame to frame.

The surface of the first frame is followed forwards and that of the last frame backwards, each
through all frames (`geometry.surface_tracking`). Of both, the one is taken that stays nearer to the
surfaces of the frames. Where neither is right in all frames, as between a ball and a ring, the
first is shown up to one frame, and the second from it on. A tunnel that closes on the way
shrinks to nothing, so that the mesh of a teapot may well become a ball.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from morph_engine.errors import ConfigError
from morph_engine.geometry.surface_reconstruction import Surface, reconstruct_surface
from morph_engine.geometry.surface_tracking import SurfaceTracker, carried, mean_distance
from morph_engine.geometry.topology import vertex_normals
from morph_engine.results.baked_texture import BakedTextures, baked, check_texture
from morph_engine.results.selection import Selection

Floats = npt.NDArray[np.float64]

CELL_OVER_H = 0.5
"""Edge of a marching cube over the lattice spacing: some 20 000 vertices for 37 000 particles."""

CHANGE_COST_OVER_H = 0.02
"""How much nearer to the surfaces two meshes must be than one, over the spacing and per frame,
to take their place."""

WORSE = 1.5
"""How much farther off a mesh may be at its far end than one that begins there, if their topology
differs, to be right in all frames."""


@dataclass(frozen=True, eq=False)
class TrackedMesh:
    """A mesh over consecutive frames of a selection.

    Attributes:
        frames: Indices of its frames, ascending.
        vertices: Corner positions by frame [units of the selection], shape [T, V, 3], float64.
        normals: Unit normals by frame, shape [T, V, 3], float64.
        faces: Vertex indices of the triangles in all frames, shape [F, 3], int32.
        colors: Colours by frame, sRGB, shape [T, V, 3], uint8; None where the shapes have none, or
            textures have them.
        textures: Pictures of the colours, if they are asked for.
    """

    frames: tuple[int, ...]
    vertices: Floats
    normals: Floats
    faces: npt.NDArray[np.int32]
    colors: npt.NDArray[np.uint8] | None = None
    textures: BakedTextures | None = None


@dataclass(frozen=True, eq=False)
class TrackedSurface:
    """The surface of a selection as one mesh, or as two where the topology changes.

    Attributes:
        meshes: One mesh, or two that have one frame in common.
        changes_at: Index of that frame: from it on the second is shown. None for one mesh.
    """

    meshes: tuple[TrackedMesh, ...]
    changes_at: int | None


@dataclass(frozen=True, eq=False)
class _Track:
    """A mesh in each frame [dx], shape [T, V, 3], and how far it is off there [h], shape [T]."""

    faces: npt.NDArray[np.int32]
    vertices: Floats
    distances: Floats


def track_surface(selection: Selection, *, vertex_limit: int | None = None) -> TrackedSurface:
    """Follow the surface through the frames of a selection, and those between them.

    Args:
        selection: Which frames, in any order. It is watched.
        vertex_limit: Most vertices of a mesh; triangles are larger where there would be more.

    Raises:
        ConfigError: The selection has fewer than two frames, or there can be no texture.
        ExtraError: A texture needs a package that is not installed.
        ResultError: A frame is damaged.
        MeshError: The particles of a frame enclose nothing.
    """
    wanted = tuple(sorted(set(selection.frames)))
    if len(wanted) < 2:
        raise ConfigError(
            "A single frame has no motion to track.",
            "Request two or more frames, or omit `tracked`.",
        )
    if selection.texture:
        check_texture(selection)
    first, last = wanted[0], wanted[-1]
    count = last - first + 1
    watch = _watch_in_frames(selection, 2 * count)
    trajectory = selection.trajectory
    positions = [np.asarray(trajectory.positions(k), np.float64) for k in range(first, last + 1)]
    spacings = [trajectory.run.spacing_of(frame) for frame in positions]
    surfaces = []
    for frame, spacing in zip(positions, spacings, strict=True):
        surfaces.append(reconstruct_surface(frame, spacing, cell_over_h=CELL_OVER_H))
        watch()
    there, back = (
        _followed(order, positions, spacings, surfaces, vertex_limit)
        for order in (range(count), range(count)[::-1])
    )
    with ThreadPoolExecutor(1, "backwards") as beside:
        for _ in range(count):  # frame by frame, so that an interruption waits for one frame only
            step = beside.submit(next, back)
            forwards, backwards = next(there), step.result()
            watch()
    ends = surfaces[0], surfaces[-1]
    same = len({(end.bodies, end.euler) for end in ends}) == 1
    change = _change(forwards.distances, backwards.distances, same=same)
    shown = {k - first for k in wanted}
    if 0 < change < count - 1:
        shown.add(change)  # where the second mesh takes over, also if nobody has asked for it
    meshes = []
    for track, span in ((forwards, range(change + 1)), (backwards, range(change, count))):
        chosen = [k for k in span if k in shown]
        if len(chosen) > 1:
            meshes.append(_placed(selection, track, chosen, first, spacings))
    most = max(len(surfaces[0].vertices), len(surfaces[-1].vertices))
    if vertex_limit is not None and most > vertex_limit:
        selection.tell(
            f"With this many frames there is room for only {vertex_limit} vertices, so "
            "the triangles are larger than usual. Use fewer frames for finer triangles."
        )
    changes_at = first + change if len(meshes) > 1 else None
    if changes_at is not None:
        selection.tell(
            f"The topology changes at frame {changes_at}, where a second mesh takes over."
        )
    return TrackedSurface(tuple(meshes), changes_at)


def still_surface(selection: Selection, *, vertex_limit: int | None = None) -> TrackedSurface:
    """The surface of a selection of one frame, in which nothing moves.

    Arguments and errors as of `track_surface`, without textures.
    """
    (frame,) = selection.frames
    positions = np.asarray(selection.trajectory.positions(frame), np.float64)
    spacing = selection.trajectory.run.spacing_of(positions)
    found = reconstruct_surface(positions, spacing, cell_over_h=CELL_OVER_H)
    found = _with_fewer(found, positions, spacing, vertex_limit)
    track = _Track(found.faces, found.vertices[None], np.zeros(1))
    return TrackedSurface((_placed(selection, track, [0], frame, [spacing]),), None)


def _followed(
    order: Sequence[int],
    positions: Sequence[Floats],
    spacings: Sequence[float],
    surfaces: Sequence[Surface],
    vertex_limit: int | None,
) -> Iterator[_Track]:
    """The surface of the first frame of an order, carried through the others one by one.

    Args:
        order: Frames as they come, forwards or backwards.
        positions: Particles of each frame [dx], shape [n, 3].
        spacings: Their lattice spacing in each frame [dx].
        surfaces: The surface of each frame.
        vertex_limit: As of `track_surface`.

    Yields:
        The track after each frame, always the same one; frames to come are undefined in it.
    """
    begin = order[0]
    mesh = _with_fewer(surfaces[begin], positions[begin], spacings[begin], vertex_limit)
    tracker = SurfaceTracker(mesh.faces, len(mesh.vertices))
    vertices = mesh.vertices
    track = _Track(mesh.faces, np.empty((len(order), *vertices.shape)), np.zeros(len(order)))
    previous = begin
    for k in order:
        if k != begin:
            vertices = carried(vertices, positions[previous], positions[k], spacings[previous])
            vertices = tracker.drawn(vertices, surfaces[k], spacings[k])
        track.vertices[k] = vertices
        shown = Surface(vertices, mesh.faces)
        track.distances[k] = mean_distance(shown, surfaces[k]) / spacings[k]
        previous = k
        yield track


def _watch_in_frames(selection: Selection, steps: int) -> Callable[[], None]:
    """What is called after each of so many steps, told as frames."""
    total = len(selection.frames)
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        selection.watch(done * total // steps, total)

    return step


def _with_fewer(
    surface: Surface, positions: Floats, spacing: float, vertex_limit: int | None
) -> Surface:
    """The same surface by larger triangles, if it has too many."""
    cell = CELL_OVER_H
    while vertex_limit is not None and len(surface.vertices) > vertex_limit:
        cell *= 1.02 * np.sqrt(len(surface.vertices) / vertex_limit)
        surface = reconstruct_surface(positions, spacing, cell_over_h=cell)
    return surface


def _change(forwards: Floats, backwards: Floats, *, same: bool) -> int:
    """Frame, counted from the first, from which on the second mesh is shown.

    Both are shown in it; 0 stands for the second mesh alone, and the last frame for the first.

    Args:
        forwards: How far the first mesh is off in each frame [h], shape [T].
        backwards: The same of the second.
        same: Whether the first and the last surface have the same topology.
    """
    last = len(forwards) - 1
    total = np.cumsum(forwards) + np.cumsum(backwards[::-1])[::-1]
    cost = {0: backwards.sum(), last: forwards.sum()}
    if not same:  # a tunnel that has closed to nothing does no harm, one that is missing does
        if backwards[0] > WORSE * forwards[0]:
            cost[0] = np.inf
        if forwards[last] > WORSE * backwards[last]:
            cost[last] = np.inf
    if last > 1:
        between = 1 + int(np.argmin(total[1:-1]))
        cost[between] = total[between] + CHANGE_COST_OVER_H * len(total)
    return min(cost, key=cost.__getitem__)


def _placed(
    selection: Selection, track: _Track, chosen: Sequence[int], first: int, spacings: list[float]
) -> TrackedMesh:
    """Some frames of a track in the units of the selection, drawn to the meshes if asked."""
    frames = tuple(first + k for k in chosen)
    apart = [spacings[k] for k in chosen]
    shapes = []
    for k, frame, spacing in zip(chosen, frames, apart, strict=True):
        shape = Surface(track.vertices[k], track.faces)
        if selection.snap:
            shape = selection.drawn_to_ends(shape, frame, spacing)
        shapes.append(shape.vertices)
    pairs = list(zip(shapes, frames, strict=True))
    vertices = np.stack([selection.placed(shape, frame) for shape, frame in pairs])
    normals = np.stack([vertex_normals(frame, track.faces) for frame in vertices])
    if selection.texture:
        textures = baked(selection, shapes, track.faces, frames, apart, selection.texture)
        return TrackedMesh(frames, vertices, normals, track.faces, textures=textures)
    colors = [
        selection.surface_colors(*pair, spacing) for pair, spacing in zip(pairs, apart, strict=True)
    ]
    known = [of_frame for of_frame in colors if of_frame is not None]
    return TrackedMesh(frames, vertices, normals, track.faces, np.stack(known) if known else None)
