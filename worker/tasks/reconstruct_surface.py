"""The surface of a frame, kept beside the job."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from chamfer_morph.worker.frame_reader import read_frame, read_run_record
from chamfer_morph.worker.sandbox.derived_files import StoredSurface
from chamfer_morph.worker.storage import writing
from morph_engine.errors import ResultError
from morph_engine.files import wait_for
from morph_engine.geometry.surface_reconstruction import reconstruct_surface, surface_deviation
from morph_engine.results.selection import Selection
from morph_engine.results.trajectory import Trajectory


def run(result: Path, index: int, path: Path) -> None:
    """Compute the surface of a frame unless it is there.

    Args:
        result: The job's result file, whether it is there or not.
        index: Index of the frame, from 0.
        path: The file to write.

    Raises:
        MeshError: The particles enclose nothing.
        ResultError: The frame has gone, or the disk refuses.
    """
    with writing("The surface"), wait_for(path.parent / "lock"):  # another API may be at it
        if StoredSurface.is_there(path, result):
            return
        frame, record = read_frame(result, index), read_run_record(result)
        if frame is None or record is None:
            raise ResultError("The frame no longer exists.", "Request it again.")
        spacing = record.spacing_of(frame.positions)
        found = reconstruct_surface(frame.positions, spacing)
        report: dict[str, Any] = {
            "watertight": found.watertight,
            "bodies": found.bodies,
            "largest": found.area_share_of_largest,
            "volume": found.volume,
        }
        target, _ = record.leg(frame.leg).fitted("target")
        if target is not None:
            report["deviation"] = surface_deviation(found, target)
        colors = snapped = None
        if result.is_file():  # the job has ended, so that its end is known
            with Trajectory(result) as trajectory:
                if index < trajectory.frame_count:
                    selection = Selection(trajectory, (index,))
                    colors = selection.surface_colors(found.vertices, index, spacing)
                    drawn = selection.drawn_to_ends(found, index, spacing)
                    snapped = None if drawn is found else drawn.vertices
        StoredSurface(found.vertices, found.faces, report, colors, snapped).save(path)
