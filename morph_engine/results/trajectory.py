"""The result file: a VTKHDF moving point cloud that ParaView opens and that repeats its own run.

`/VTKHDF` is temporal PolyData as VTK >= 9.3 reads it: one step per frame, one vertex per particle,
det F as point data where the method has it, the metrics as field data. `/morph` holds the run
record, the events, the status and, where a shape has colours, those of the particles. Every array
is stored with a checksum in chunks, a frame per chunk: a flipped bit costs one frame and is
noticed.
"""

from __future__ import annotations

import io
import json
import operator
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from morph_engine.config import MorphConfig
from morph_engine.errors import DamagedError, ResultError
from morph_engine.files import replacing
from morph_engine.results.run_record import Json, RunRecord, Shape, Units
from morph_engine.results.spool import Spool

Status = Literal["complete", "partial"]

_FORMAT = 2
"""1: the configuration is that of version 0.1.0."""
_CELLS = ("Vertices", "Lines", "Polygons", "Strips")


def write_result(spool: Spool, path: str | Path | None = None, *, status: Status) -> Path:
    """Assemble the result file of all finished frames; the spool stays as it is.

    Without a path it is the spool's own result file.

    Raises:
        ResultError: A frame of the spool is damaged, or the disk refuses.
    """
    path = spool.result_path if path is None else Path(path)
    remedy = f"Free some disk space and resume; the frames are safe in {spool.path}."
    with (
        writing(path, remedy),
        replacing(path) as temporary,
        _DiskFile(temporary, "w+") as disk,
        disk.errors_raised_at_end(),
        # older formats have no checksums in their structure, and VTK 9.7 cannot read the latest
        h5py.File(disk, "w", libver=("v110", "v110")) as file,
    ):
        _write_vtk(file.create_group("VTKHDF"), spool)
        _write_morph(file.create_group("morph"), spool, status)
    return path


class _DiskFile(io.FileIO):
    """A file that keeps the first error of its disk to the end: HDF5 may crash at one.

    What is written after that is lost.
    """

    _error: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of some bytes, at the place where the file is."""
        rest = memoryview(data)
        try:
            while rest and self._error is None:
                rest = rest[super().write(rest) :]
        except OSError as error:
            self._error = error
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Make the file longer or shorter."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._error = self._error or error
            return self.tell()

    @contextmanager
    def errors_raised_at_end(self) -> Iterator[None]:
        """Raise the error that was kept, whatever the body raises for it."""
        try:
            yield
        finally:
            if self._error is not None:
                raise self._error


def check_replaces_no_result(result: Path | str | Trajectory, path: Path) -> None:
    """Refuse to write what is made from a result over that result.

    Raises:
        ResultError: The path is that of the result, by whatever name.
    """
    source = result.path if isinstance(result, Trajectory) else Path(result)
    if path.exists() and source.exists() and path.samefile(source):
        raise ResultError(
            f"{path} is the result that is to be read, which it would replace.",
            "Choose another file to write.",
        )


@contextmanager
def writing(
    path: Path, remedy: str = "Free some disk space, or choose another place."
) -> Iterator[None]:
    """Say what the disk refuses.

    Raises:
        ResultError: The body raised an `OSError`.
    """
    try:
        yield
    except OSError as error:
        raise ResultError(f"Cannot write {path} ({error.strerror or error}).", remedy) from error


def _write_vtk(root: h5py.Group, spool: Spool) -> None:
    """Temporal PolyData of one part, whose topology is stored once and shared by all steps."""
    frame_count, particle_count = spool.frame_count, spool.run.particle_count
    root.attrs["Version"] = np.array([2, 3])
    root.attrs.create("Type", np.bytes_("PolyData"))  # VTK wants ASCII of fixed length

    points = root.create_dataset(
        "Points",
        shape=(frame_count * particle_count, 3),
        maxshape=(None, 3),
        dtype=np.float32,
        chunks=(particle_count, 3),
        fletcher32=True,
    )
    for frame in range(frame_count):
        points[frame * particle_count : (frame + 1) * particle_count] = spool.positions(frame)

    with_det_f = frame_count > 0 and all(
        spool.det_f(frame) is not None for frame in range(frame_count)
    )
    if with_det_f:
        det_f = root.create_group("PointData").create_dataset(
            "det_f",
            (frame_count * particle_count,),
            "<f4",
            chunks=(particle_count,),
            fletcher32=True,
        )
        for frame in range(frame_count):
            det_f[frame * particle_count : (frame + 1) * particle_count] = spool.det_f(frame)

    shown = particle_count if frame_count else 0  # a run stopped in its first frame shows nothing
    _store(root, "NumberOfPoints", np.array([shown]))
    for kind in _CELLS:
        cell_count = shown if kind == "Vertices" else 0
        cells = root.create_group(kind)
        _store(cells, "NumberOfCells", np.array([cell_count]))
        _store(cells, "NumberOfConnectivityIds", np.array([cell_count]))
        _store(cells, "Connectivity", np.arange(cell_count))
        _store(cells, "Offsets", np.arange(cell_count + 1))

    frames = np.arange(frame_count)
    same = np.zeros(frame_count, np.int64)
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = frame_count
    _store(steps, "Values", frames.astype(np.float64))
    _store(steps, "PartOffsets", same)
    _store(steps, "NumberOfParts", same + 1)
    _store(steps, "PointOffsets", frames * particle_count)
    if with_det_f:
        _store(steps.create_group("PointDataOffsets"), "det_f", frames * particle_count)
    _store(steps, "CellOffsets", np.zeros((frame_count, len(_CELLS)), np.int64))
    _store(steps, "ConnectivityIdOffsets", np.zeros((frame_count, len(_CELLS)), np.int64))

    fields = root.create_group("FieldData")
    offsets = steps.create_group("FieldDataOffsets")
    sizes = steps.create_group("FieldDataSizes")
    table = [spool.metrics(frame) for frame in range(frame_count)]
    for name in dict.fromkeys(name for row in table for name in row):
        _store(fields, name, np.array([row.get(name, np.nan) for row in table], np.float64))
        _store(offsets, name, frames)
        _store(sizes, name, np.ones((frame_count, 2), np.int64))  # components, tuples


def _write_morph(root: h5py.Group, spool: Spool, status: Status) -> None:
    root.attrs["format"] = _FORMAT
    _store_json(root, "status", status)
    _store_json(root, "events", spool.events)
    if spool.run.leg_count > 1:
        _store(root, "legs", np.array([spool.leg_of(frame) for frame in range(spool.frame_count)]))
    _write_colors(root, spool)
    run = root.create_group("run")
    for key, value in spool.run.document().items():
        _store_json(run, key, value)
    arrays = root.create_group("arrays")
    for name, array in spool.run.arrays().items():
        _store(arrays, name, array)


def _write_colors(root: h5py.Group, spool: Spool) -> None:
    if not spool.run.colored:
        return
    from morph_engine.results.colors import particle_colors

    colors = particle_colors(spool)
    if colors is not None:
        _store(root, "colors", colors)
        root["colors"].attrs["space"] = "sRGB"
        root["colors"].attrs["axes"] = "shape, particle, channel"


def _store(group: h5py.Group, name: str, array: NDArray[Any]) -> None:
    """Store an array as one chunk with a checksum."""
    checked = {"chunks": array.shape, "fletcher32": True} if array.size else {}
    group.create_dataset(name, data=array, **checked)


def _store_json(group: h5py.Group, name: str, value: Any) -> None:
    """Store JSON as one string of fixed length: those of variable length have no checksum."""
    text = json.dumps(value).encode()
    _store(group, name, np.array([text], h5py.string_dtype(length=len(text))))


class Trajectory:
    """A result file, open for reading; close it with `close` or `with`.

    Arrays are read when asked for. Iterating yields the positions of each frame in order. Frames
    are named by their index from 0; negative ones count from the end.

    Attributes:
        path: The result file.
        status: "complete", or "partial" for a run that was stopped.
        frame_count: Number of frames T.
        particle_count: Number of particles n.

    Raises:
        ResultError: The file is missing, truncated or not a result file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path: Path = Path(path)
        if not self.path.is_file():
            raise ResultError(f"There is no result file {path}.", "Check the path.")
        with _reading(self.path):
            # some network disks have no locks; the file is never changed in place
            self._file = h5py.File(self.path, "r", locking="best-effort")
        try:
            with _reading(self.path):
                self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        morph, vtk = self._file["morph"], self._file["VTKHDF"]
        if morph.attrs["format"] > _FORMAT:
            raise ResultError(
                f"{self.path} was written by a newer version.", "Update chamfer-morph to read it."
            )
        self.status: Status = _json(morph["status"])
        self.frame_count: int = int(vtk["Steps"].attrs["NSteps"])
        self._points = vtk["Points"]
        self.particle_count: int = self._points.chunks[0]
        if self._points.shape != (self.frame_count * self.particle_count, 3):
            raise ValueError(f"it holds {len(self._points)} points")

    def positions(self, frame: int) -> NDArray[np.float32]:
        """Positions of one frame [dx], shape [n, 3], float32, in the original particle order.

        Raises:
            ResultError: There is no such frame, the file has been closed, or the frame's checksum
                fails; others may still be read.
        """
        index = self.index(frame)
        start = index * self.particle_count
        with self._reading(f"frame {index} of "):
            positions: NDArray[np.float32] = self._points[start : start + self.particle_count]
            return positions

    def positions_in_user_units(self, frame: int) -> NDArray[np.float64]:
        """Positions of one frame [unit of the user's own files], shape [n, 3], float64.

        Raises:
            ResultError: As `positions`.
        """
        matrix = self.transform_at(frame)
        positions: NDArray[np.float64] = self.positions(frame) @ matrix[:3, :3].T + matrix[:3, 3]
        return positions

    def det_f(self, frame: int) -> NDArray[np.float32] | None:
        """det F of each particle in one frame [ratio], shape [n], float32.

        None where the file has none: its method moves points without deforming matter, or an older
        version wrote it.

        Raises:
            ResultError: As `positions`.
        """
        index = self.index(frame)
        start = index * self.particle_count
        with self._reading(f"det F of frame {index} of "):
            stored = self._file.get("VTKHDF/PointData/det_f")
            if stored is None:
                return None
            det_f: NDArray[np.float32] = stored[start : start + self.particle_count]
            return det_f

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """Time of each frame as VTK shows it: its index, shape [T], float64."""
        with self._reading():
            times: NDArray[np.float64] = self._file["VTKHDF/Steps/Values"][:]
            return times

    @cached_property
    def metrics(self) -> dict[str, NDArray[np.float64]]:
        """Metrics over frames by name, shape [T], float64; NaN where a frame lacks one.

        Raises:
            ResultError: A checksum fails.
        """
        with self._reading():
            return {name: field[:] for name, field in self._file["VTKHDF/FieldData"].items()}

    def metrics_at(self, frame: int) -> dict[str, float]:
        """Metrics of one frame by name, without those it lacks.

        Raises:
            ResultError: There is no such frame, or a checksum fails.
        """
        index = self.index(frame)
        row = {name: float(values[index]) for name, values in self.metrics.items()}
        return {name: value for name, value in row.items() if not np.isnan(value)}

    @cached_property
    def events(self) -> list[Json]:
        """Events of all frames in order, each with frame, kind, message and data.

        Raises:
            ResultError: The checksum fails.
        """
        with self._reading():
            events: list[Json] = _json(self._file["morph/events"])
            return events

    @cached_property
    def run(self) -> RunRecord:
        """What the run was made of, enough to repeat it.

        Raises:
            ResultError: A checksum fails.
        """
        with self._reading():
            morph = self._file["morph"]
            document = {name: _json(value) for name, value in morph["run"].items()}
            arrays = {name: array[:] for name, array in morph["arrays"].items()}
            return RunRecord.restore(document, arrays)

    @cached_property
    def colors(self) -> NDArray[np.uint8] | None:
        """Colours of the particles in each shape of the run, sRGB, shape [stops, n, 3], uint8.

        None where no shape has colours. `results.colors` tells how they are blended; of a run that
        was stopped, the last frame stands for the shape that it was to reach.

        Raises:
            ResultError: The checksum fails.
        """
        with self._reading():
            stored = self._file.get("morph/colors")
            if stored is None:
                return None
            colors: NDArray[np.uint8] = stored[:]
            return colors

    @property
    def config(self) -> MorphConfig:
        """Resolved configuration of the run."""
        return self.run.config

    @property
    def source(self) -> Shape:
        """Source shape in the user's own coordinates: a mesh, or points of shape [n, 3]."""
        return self.run.source

    @property
    def target(self) -> Shape:
        """Target shape in the user's own coordinates: a mesh, or points of shape [n, 3]."""
        return self.run.target

    @property
    def target_points(self) -> NDArray[np.float32]:
        """Target points [dx], shape [m, 3], float32."""
        return self.run.target_points

    @property
    def transform(self) -> NDArray[np.float64]:
        """Grid units to the target's coordinates, shape [4, 4], float64; acts on columns."""
        return self.run.transform

    @cached_property
    def legs(self) -> NDArray[np.int64]:
        """Index of the leg that each frame belongs to, shape [T], int64.

        Raises:
            ResultError: The checksum fails.
        """
        with self._reading():
            stored = self._file.get("morph/legs")
            if stored is None:
                return np.zeros(self.frame_count, np.int64)
            legs: NDArray[np.int64] = stored[:]
            return legs

    def leg_of(self, frame: int) -> int:
        """Index of the leg that a frame belongs to.

        Raises:
            ResultError: There is no such frame.
        """
        return int(self.legs[self.index(frame)])

    def frame_in_leg(self, frame: int) -> int:
        """Index of a frame in its leg, from 0.

        Raises:
            ResultError: There is no such frame.
        """
        return self.index(frame) - int(np.searchsorted(self.legs, self.leg_of(frame)))

    def is_finished(self, leg: int) -> bool:
        """Whether a leg has reached its target."""
        return self.status == "complete" or bool((self.legs > leg).any())

    def positions_in_shape(self, stop: int) -> NDArray[np.float32]:
        """Positions of the particles in a shape of the run, 0 for the source [dx], shape [n, 3].

        That is the last frame of the leg that leads to it, also where the leg has not ended.

        Raises:
            ResultError: The frame is damaged.
        """
        if stop == 0:
            return self.run.source_points
        return self.positions(int(np.searchsorted(self.legs, stop)) - 1)

    def planned_frames_of(self, leg: int) -> int:
        """Number of frames until the target of a leg is reached; one that was stopped has fewer."""
        return int((self.legs == leg).sum()) if self.is_finished(leg) else self.config.frames

    def transform_at(self, frame: int, units: Units = "user") -> NDArray[np.float64]:
        """Grid units to other units in one frame, shape [4, 4], float64; acts on columns.

        Raises:
            ResultError: There is no such frame.
        """
        leg = self.leg_of(frame)
        share = (self.frame_in_leg(frame) + 1) / self.planned_frames_of(leg)
        return self.run.transform_to(units, share, leg)

    @property
    def software(self) -> dict[str, str]:
        """Versions of the software that made the numbers."""
        return self.run.software

    def close(self) -> None:
        """Close the file; arrays already read stay."""
        self._file.close()

    def _repr_html_(self) -> str | None:
        """What a notebook displays: a viewer with some of the particles, which can be turned."""
        from morph_engine.export.html import embedded

        return embedded(self)

    def __len__(self) -> int:
        return self.frame_count

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        return (self.positions(frame) for frame in range(self.frame_count))

    def __enter__(self) -> Trajectory:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def index(self, frame: int) -> int:
        """Index from 0 of a frame, negative ones counted from the end.

        Raises:
            ResultError: There is no such frame, or it is no integer.
        """
        try:
            index = operator.index(frame)
        except TypeError:
            raise ResultError(
                f"{frame!r} is not the index of a frame.",
                "Give an integer: 0 is the first frame, -1 the last.",
            ) from None
        if not -self.frame_count <= index < self.frame_count:
            raise ResultError(
                f"{self.path} has no frame {index}.",
                f"Its {self.frame_count} frames are numbered from 0.",
            )
        return index % self.frame_count

    @contextmanager
    def _reading(self, part: str = "") -> Iterator[None]:
        """Say why something cannot be read of the file.

        Raises:
            ResultError: It is closed, or damaged.
        """
        if not self._file:
            raise ResultError(
                f"{self.path} has been closed.", "Open it again, or read what you need before."
            )
        with _reading(self.path, part):
            yield


def opened(result: Path | str | Trajectory) -> AbstractContextManager[Trajectory]:
    """A result that is closed at the end if it is opened here."""
    return nullcontext(result) if isinstance(result, Trajectory) else Trajectory(result)


def _json(dataset: h5py.Dataset) -> Any:
    return json.loads(dataset[0])


@contextmanager
def _reading(path: Path, part: str = "") -> Iterator[None]:
    try:
        yield
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        if "memory allocation failed" in str(error):  # as HDF5 says it of a file that is sound
            raise MemoryError(f"There is not enough memory to read {path}.") from error
        raise DamagedError(
            f"Cannot read {part}{path}, which is damaged or not a result file ({error}).",
            "Copy it again from the original, or repeat the run.",
        ) from error
