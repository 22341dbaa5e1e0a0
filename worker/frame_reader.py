"""Frames of a job: of its result file, or of the run directory beside it where that has more."""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from morph_engine.errors import ResultError
from morph_engine.results.run_record import RunRecord, Units
from morph_engine.results.spool import SpoolReader, finished_frames
from morph_engine.results.trajectory import Trajectory

Read = TypeVar("Read")

ATTEMPTS = 3
"""A job may finish, or go on, while it is read."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a job.

    Attributes:
        index: Its index, from 0.
        positions: Particle positions [grid units], shape [n, 3], float32.
        leg: Index of the leg that it belongs to, of a morph through several shapes.
    """

    index: int
    positions: NDArray[np.float32]
    leg: int = 0


@dataclass(frozen=True, eq=False)
class Colors:
    """Colours of the particles of a job.

    Attributes:
        rgb: What they are in each shape of the job, sRGB, shape [shapes, n, 3], uint8.
        reached: Number of frames after which each shape is reached, ascending from 0.
    """

    rgb: NDArray[np.uint8]
    reached: list[int]

    def at(self, frame: int) -> NDArray[np.uint8]:
        """Those in a frame, sRGB, shape [n, 3], uint8."""
        from morph_engine import srgb
        from morph_engine.results.colors import blended

        ahead = min(bisect.bisect_left(self.reached, frame + 1), len(self.reached) - 1)
        begin, end = self.reached[ahead - 1], self.reached[ahead]
        one, other = srgb.from_bytes(self.rgb[ahead - 1 : ahead + 1])
        return srgb.to_bytes(blended(one, other, (frame + 1 - begin) / (end - begin)))


def read_frame(result: Path, index: int) -> Frame | None:
    """A frame, or None where there is none of that index.

    Args:
        result: The result file, whether it is there or not.
        index: Index of the frame; negative counts from the end.

    Raises:
        ResultError: It is damaged.
    """

    def read(run: SpoolReader | Trajectory) -> Frame | None:
        count = run.frame_count
        if not -count <= index < count:
            return None
        frame = index % count
        return Frame(frame, run.positions(frame), run.leg_of(frame))

    return _read(result, read)


def read_det_f(result: Path, index: int) -> NDArray[np.float32] | None:
    """det F of each particle of a frame that is there [ratio], shape [n], float32.

    None where the method has none.

    Raises:
        ResultError: It is damaged.
    """
    return _read(result, lambda run: run.det_f(index))


def read_colors(result: Path) -> Colors | None:
    """Colours that the result file of a job has; None where it has none, or not yet all frames.

    Raises:
        ResultError: It is damaged.
    """
    if not result.is_file() or has_unsaved_frames(result):
        return None
    with Trajectory(result) as trajectory:
        return _timed(trajectory, trajectory.colors)


def look_up_colors(result: Path) -> Colors | None:
    """Colours of the particles of a job; None where no shape has any, or it has not begun.

    While the job runs they are looked up in the meshes, which takes seconds for large ones, and
    holds up all other threads.

    Raises:
        ResultError: It is damaged.
    """

    def read(run: SpoolReader | Trajectory) -> Colors | None:
        from morph_engine.results.colors import particle_colors

        return _timed(run, run.colors if isinstance(run, Trajectory) else particle_colors(run))

    return _read(result, read)


def read_transform(result: Path, index: int, units: Units) -> NDArray[np.float64]:
    """Grid units to other units in a frame that is there, shape [4, 4]; acts on columns.

    Raises:
        FileNotFoundError: The job has gone.
        ResultError: It is damaged.
    """
    transform = _read(result, lambda run: run.transform_at(index, units))
    if transform is None:
        raise FileNotFoundError(result)
    return transform


def read_run_record(result: Path) -> RunRecord | None:
    """What a job is made of, or None where it has not begun.

    Raises:
        ResultError: It is damaged.
    """
    return _read(result, lambda run: run.run)


def count_frames(result: Path) -> int:
    """Number of frames that `read_frame` finds."""
    return max(finished_frames(result), _count_of_result(result))


def has_unsaved_frames(result: Path) -> bool:
    """Whether the run directory has frames that the result lacks.

    A job runs, or its engine was killed.
    """
    in_run = finished_frames(result)
    return in_run > 0 and in_run > _count_of_result(result)


def _read(result: Path, read: Callable[[SpoolReader | Trajectory], Read | None]) -> Read | None:
    """What is read of a job; None where it has not begun.

    That is from the run directory, unless the result file has more frames.
    """
    for attempt in range(ATTEMPTS):
        spool = SpoolReader(result)
        try:
            if spool.exists and spool.frame_count >= _count_of_result(result):
                return read(spool)
            if not result.is_file():
                return None
            with Trajectory(result) as trajectory:
                return read(trajectory)
        except ResultError:
            if attempt == ATTEMPTS - 1:
                raise
    return None


def _timed(run: SpoolReader | Trajectory, colors: NDArray[np.uint8] | None) -> Colors | None:
    """Colours with the numbers of frames after which they are reached."""
    if colors is None:
        return None
    frames = [run.planned_frames_of(leg) for leg in range(len(colors) - 1)]
    return Colors(colors, [0, *itertools.accumulate(frames)])


def _count_of_result(result: Path) -> int:
    try:
        with Trajectory(result) as trajectory:
            return trajectory.frame_count
    except ResultError:
        return 0
