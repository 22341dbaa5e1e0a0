"""Single frames of a job, from its result or from what it has finished so far, as bytes."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morph_engine.errors import ResultError
from morph_engine.spool import finished_frames, read_positions
from morph_engine.trajectory import Trajectory
from server.schemas import FrameFormat

PLY = "application/x-ply"
NPY = "application/x-npy"
LEVELS = 65535


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a job.

    Attributes:
        index: Its index, from 0.
        positions: Particle positions [grid units], shape [n, 3], float32.
    """

    index: int
    positions: NDArray[np.float32]


def read(result: Path, index: int, finished: bool) -> Frame | None:
    """A frame, or None where there is none of that index.

    Args:
        result: The result file, whether it is there or not.
        index: Index of the frame; negative counts from the end.
        finished: Whether the job is; then the result file is newer than its run directory.
    """
    sources = (_from_result, _from_run) if finished else (_from_run, _from_result)
    for source in (*sources, sources[0]):  # a job may finish between the first two
        frame = source(result, index)
        if frame is not None:
            return frame
    return None


def encode(positions: NDArray[np.float32], format: FrameFormat, extent: float) -> tuple[bytes, str]:
    """Positions as bytes.

    Args:
        positions: Particle positions [grid units], shape [n, 3], float32.
        format: f32, u16, ply or npy.
        extent: Half edge of the domain, which the levels of u16 divide evenly [grid units].

    Returns:
        The bytes and their media type.
    """
    plain = np.ascontiguousarray(positions, "<f4")
    if format == "f32":
        return plain.tobytes(), "application/octet-stream"
    if format == "u16":
        levels = np.nan_to_num((plain.astype(np.float64) + extent) * (LEVELS / (2 * extent)))
        quantised = np.rint(levels).clip(0, LEVELS).astype("<u2")
        return quantised.tobytes(), "application/octet-stream"
    if format == "npy":
        file = io.BytesIO()
        np.save(file, plain, allow_pickle=False)
        return file.getvalue(), NPY
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment lengths in grid units\n"
        f"element vertex {len(plain)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    return header.encode() + plain.tobytes(), PLY


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
