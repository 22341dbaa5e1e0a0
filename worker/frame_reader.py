"""What a job has to show, from its result or, while it runs, from the run directory beside it."""

from __future__ import annotations

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


def read_frame(result: Path, index: int, finished: bool) -> Frame | None:
    """A frame, or None where there is none of that index.

    Args:
        result: The result file, whether it is there or not.
        index: Index of the frame; negative counts from the end.
        finished: Whether the job is; then the result file counts, unless it lacks frames.
    """
    use_result = finished and not has_unkept_frames(result)
    sources = (_from_result, _from_run) if use_result else (_from_run, _from_result)
    for source in (*sources, sources[0]):  # a job may finish between the first two
        frame = source(result, index)
        if frame is not None:
            return frame
    return None


def read_det_f(result: Path, index: int) -> NDArray[np.float32] | None:
    """det F of each particle of a frame that is there [ratio], shape [n], float32.

    None where the method has none.
    """
    try:
        return spool.read_det_f(result, index)
    except ResultError:
        with Trajectory(result) as trajectory:
            return trajectory.det_f(index)


def count_frames(result: Path, finished: bool) -> int:
    """Number of frames that `read_frame` finds."""
    in_run = finished_frames(result)
    if finished:
        return max(in_run, _count_of_result(result))
    return in_run or _count_of_result(result)


def has_unkept_frames(result: Path) -> bool:
    """Whether the run directory has frames that the result lacks: its engine was killed."""
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
