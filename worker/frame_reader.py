"""Frames of a job: of its result file, or of the run directory beside it where that has more."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from morph_engine.errors import ResultError
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.sampling import fit_to_domain
from morph_engine.results import spool
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import finished_frames, read_positions, read_run
from morph_engine.results.trajectory import Trajectory

Role = Literal["source", "target"]


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a job.

    Attributes:
        index: Its index, from 0.
        positions: Particle positions [grid units], shape [n, 3], float32.
    """

    index: int
    positions: NDArray[np.float32]


def read_frame(result: Path, index: int) -> Frame | None:
    """A frame, or None where there is none of that index.

    Args:
        result: The result file, whether it is there or not.
        index: Index of the frame; negative counts from the end.
    """
    for _ in range(3):  # a job may finish, or go on, between two looks
        frame = (_from_run if has_unsaved_frames(result) else _from_result)(result, index)
        if frame is not None:
            return frame
    return None


def read_det_f(result: Path, index: int) -> NDArray[np.float32] | None:
    """det F of each particle of a frame that is there [ratio], shape [n], float32.

    None where the method has none.
    """
    if has_unsaved_frames(result):
        with suppress(ResultError):  # the job finishes just now
            return spool.read_det_f(result, index)
    with Trajectory(result) as trajectory:
        return trajectory.det_f(index)


def count_frames(result: Path) -> int:
    """Number of frames that `read_frame` finds."""
    return max(finished_frames(result), _count_of_result(result))


def has_unsaved_frames(result: Path) -> bool:
    """Whether the run directory has frames that the result lacks.

    A job runs, or its engine was killed.
    """
    in_run = finished_frames(result)
    return in_run > 0 and in_run > _count_of_result(result)


def read_record(result: Path) -> RunRecord | None:
    """What a job is made of, or None where it has not begun."""
    for _ in range(2):  # it may finish between the two
        if result.is_file():
            with Trajectory(result) as trajectory:
                return trajectory.run
        try:
            return read_run(result)
        except ResultError:
            continue
    return None


def mesh_in_grid_units(record: RunRecord, role: Role) -> Mesh | None:
    """The mesh of a shape as the job has placed it in the domain; None where it is a cloud."""
    shape = getattr(record, role)
    if not isinstance(shape, Mesh):
        return None
    return fit_to_domain(shape, mode=record.config["sampling"]["fit"])[0]


def _from_result(result: Path, index: int) -> Frame | None:
    if not result.is_file():
        return None
    try:
        with Trajectory(result) as trajectory:
            count = trajectory.frame_count
            if not -count <= index < count:
                return None
            return Frame(index % count, trajectory.positions(index))
    except ResultError:
        if not result.is_file():  # it went away under our hands
            return None
        raise


def _from_run(result: Path, index: int) -> Frame | None:
    count = finished_frames(result)
    if not -count <= index < count:
        return None
    try:
        return Frame(index % count, read_positions(result, index % count))
    except ResultError:
        if finished_frames(result) < count:
            return None
        raise


def _count_of_result(result: Path) -> int:
    try:
        with Trajectory(result) as trajectory:
            return trajectory.frame_count
    except ResultError:
        return 0
