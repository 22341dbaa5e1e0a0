"""The run directory `<result>.spool`: what a run has finished, safe at any instant.

run.json and run.npz   the run record, written first
frame-000000.npz       one frame: positions, det F where the method has it, metrics, events
checkpoint.npz         the state after one frame, from which the run continues bit for bit
lock                   held by the one process that writes

Each file appears or changes as a whole, so a kill at any instant leaves whole frames and a whole
checkpoint. The checkpoint decides where a run continues: frames beyond it are computed again.
"""

from __future__ import annotations

import bisect
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from morph_engine.errors import DamagedError, DiskSpaceError, ResultError
from morph_engine.files import UNREADABLE, acquire, replacing
from morph_engine.results.run_record import Json, RunRecord, Units

_RUN = "run.json"
_ARRAYS = "run.npz"
_CHECKPOINT = "checkpoint.npz"
_JSON = "__json__"


def spool_path(result_path: str | Path) -> Path:
    """The run directory that belongs to a result file."""
    return Path(f"{result_path}.spool")


def checkpoint_path(result_path: str | Path) -> Path:
    """The last checkpoint of the run that belongs to a result file."""
    return spool_path(result_path) / _CHECKPOINT


def keep_checkpoint(result_path: str | Path, path: Path) -> None:
    """Copy the last checkpoint of a run to where no later one replaces it.

    Raises:
        ResultError: There is none, or the disk refuses.
    """
    with _writing(path):
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as temporary:
            shutil.copyfile(checkpoint_path(result_path), temporary)


def finished_frames(result_path: str | Path) -> int:
    """Number of frames that a run has finished by now; 0 where there is no run."""
    try:
        names = [entry.name for entry in spool_path(result_path).iterdir()]
    except FileNotFoundError:
        return 0
    return sum(name.startswith("frame-") and name.endswith(".npz") for name in names)


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The state of a run after one frame.

    Attributes:
        frame: Index of the last frame it includes.
        arrays: Array state by name; what they hold is the engine's own affair.
        scalars: Other state, JSON only; floats and integers come back exactly.
    """

    frame: int
    arrays: dict[str, NDArray[Any]]
    scalars: Json


class SpoolReader:
    """The frames that a run has finished by now, while another process may be writing it.

    Attributes:
        path: The run directory, which need not be there.
        result_path: The result file it belongs to.
        frame_count: Number of finished frames; their indices run from 0.
    """

    def __init__(self, result_path: str | Path) -> None:
        self.path: Path = spool_path(result_path)
        self.result_path: Path = Path(result_path)
        self.frame_count: int = finished_frames(result_path)

    @property
    def exists(self) -> bool:
        """Whether there is an unfinished run."""
        return (self.path / _RUN).is_file()

    @cached_property
    def run(self) -> RunRecord:
        """What the run is made of.

        Raises:
            ResultError: There is no such run, or it is damaged.
        """
        return _read_run(self.path)

    def positions(self, frame: int) -> NDArray[np.float32]:
        """Positions of a finished frame [dx], shape [n, 3], float32, in the original order.

        Raises:
            ResultError: The frame is missing or damaged.
        """
        with _stored(self._frame_path(frame)) as arrays:
            positions: NDArray[np.float32] = arrays["positions"]
            return positions

    def det_f(self, frame: int) -> NDArray[np.float32] | None:
        """det F of a finished frame [ratio], shape [n], float32; None where the method has none.

        Raises:
            ResultError: The frame is missing or damaged.
        """
        with _stored(self._frame_path(frame)) as arrays:
            return arrays.get("det_f")

    def leg_of(self, frame: int) -> int:
        """Index of the leg that a finished frame belongs to.

        Raises:
            ResultError: The frame is missing or damaged.
        """
        if self.run.leg_count == 1:
            return 0
        with _stored(self._frame_path(frame)) as arrays:
            return int(_decode(arrays[_JSON])["leg"])

    def frame_in_leg(self, frame: int) -> int:
        """Index of a finished frame in its leg, from 0.

        Raises:
            ResultError: A frame is missing or damaged.
        """
        return frame - bisect.bisect_left(range(frame), self.leg_of(frame), key=self.leg_of)

    def planned_frames_of(self, leg: int) -> int:
        """Number of frames until the target of a leg is reached; one that was stopped has fewer.

        Raises:
            ResultError: A frame is missing or damaged.
        """
        frames = range(self.frame_count)
        begin, end = (bisect.bisect_left(frames, k, key=self.leg_of) for k in (leg, leg + 1))
        return end - begin if end < self.frame_count else self.run.config.frames

    def positions_in_shape(self, stop: int) -> NDArray[np.float32]:
        """Positions of the particles in a shape of the run, 0 for the source [dx], shape [n, 3].

        That is the last frame of the leg that leads to it, also where the leg has not ended.

        Raises:
            ResultError: A frame is missing or damaged.
        """
        if stop == 0:
            return self.run.source_points
        frames = range(self.frame_count)
        return self.positions(bisect.bisect_left(frames, stop, key=self.leg_of) - 1)

    def transform_at(self, frame: int, units: Units = "user") -> NDArray[np.float64]:
        """Grid units to other units in one frame, shape [4, 4], float64; acts on columns.

        Raises:
            ResultError: As `run`.
        """
        leg = self.leg_of(frame)
        share = (self.frame_in_leg(frame) + 1) / self.planned_frames_of(leg)
        return self.run.transform_to(units, share, leg)

    def _frame_path(self, frame: int) -> Path:
        return self.path / f"frame-{frame:06d}.npz"


class Spool(SpoolReader):
    """A run directory, made by `create` or `open` and closed by `close` or `with`."""

    def __init__(self, result_path: Path, run: RunRecord, lock: BinaryIO | None) -> None:
        super().__init__(result_path)
        self.run = run
        self._lock = lock
        self._notes = self._read_notes()  # metrics and events of each frame
        self.frame_count: int = len(self._notes)

    @classmethod
    def create(cls, result_path: str | Path, run: RunRecord, *, replace: bool = False) -> Spool:
        """Start a run directory beside the result file to come, locked for this process.

        With `replace`, an unfinished run found there is discarded.

        Raises:
            ResultError: Another process writes it, an unfinished run stands there, or the disk
                refuses.
        """
        path = spool_path(result_path)
        with _writing(path):
            path.mkdir(parents=True, exist_ok=True)
            lock = _lock(path)
            try:
                if (path / _RUN).exists() and not replace:
                    raise ResultError(
                        f"{path} contains an unfinished run.",
                        "Continue it with `resume`, or delete that directory to start over.",
                    )
                _clear(path)
                with replacing(path / _ARRAYS) as file:
                    _save_arrays(file, run.arrays())
                with replacing(path / _RUN) as file:
                    file.write_text(json.dumps(run.document(), indent=1), encoding="utf-8")
            except BaseException:
                lock.close()
                raise
        return cls(Path(result_path), run, lock)

    @classmethod
    def open(
        cls, result_path: str | Path, run: RunRecord | None = None, *, writable: bool = True
    ) -> Spool:
        """Open the run directory that an earlier process left, or that another one writes.

        With `run`, it must be made of that. It is locked to go on with the run if it is `writable`;
        else only what is finished by now is read.

        Raises:
            ResultError: There is none, another process writes it, it is damaged, or it is of
                another run (the message names the first difference).
        """
        path = spool_path(result_path)
        if not (path / _RUN).is_file():
            raise ResultError(
                f"There is no unfinished run at {path}.", "Start the run without `resume`."
            )
        with _writing(path):
            lock = _lock(path) if writable else None
        try:
            stored = _read_run(path)
            if run is not None:
                _check_same(path, stored.document(), run.document())
            return cls(Path(result_path), stored, lock)
        except BaseException:
            if lock is not None:
                lock.close()
            raise

    @property
    def events(self) -> list[Json]:
        """Events of all finished frames, in order."""
        return [event for notes in self._notes for event in notes["events"]]

    def leg_of(self, frame: int) -> int:
        """As of `SpoolReader`."""
        leg: int = self._notes[frame].get("leg", 0)
        return leg

    def metrics(self, frame: int) -> dict[str, float]:
        """Metrics of a finished frame by name; units as the metrics module defines them."""
        return dict(self._notes[frame]["metrics"])

    def positions(self, frame: int) -> NDArray[np.float32]:
        """As of `SpoolReader`; another number of particles is damage, too."""
        positions = super().positions(frame)
        with _reading(self._frame_path(frame)):
            if positions.shape != (self.run.particle_count, 3):
                raise ValueError(f"holds an array of shape {positions.shape}")
        return positions

    def append(
        self,
        frame: int,
        positions: NDArray[np.float32],
        metrics: Mapping[str, float],
        events: Sequence[Mapping[str, Any]] = (),
        det_f: NDArray[np.float32] | None = None,
        leg: int = 0,
    ) -> None:
        """Add the next frame; when this returns, no crash can take it away.

        Args:
            frame: Its index, which is `frame_count`.
            positions: Particle positions [dx], shape [n, 3], float32, original particle order.
            metrics: Metrics by name; a frame may lack some.
            events: JSON objects with frame, kind, message and data.
            det_f: det F of each particle [ratio], shape [n], float32, where the method has it.
            leg: Index of the leg that it belongs to.

        Raises:
            ResultError: The disk refuses.
            ValueError: The frame is not the next one, or an array has another shape.
        """
        if frame != self.frame_count:
            raise ValueError(f"frame {frame} after {self.frame_count} frames")
        if positions.shape != (self.run.particle_count, 3):
            raise ValueError(f"positions of shape {positions.shape}")
        if det_f is not None and det_f.shape != (self.run.particle_count,):
            raise ValueError(f"det F of shape {det_f.shape}")
        notes: Json = {
            "metrics": {name: float(value) for name, value in metrics.items()},
            "events": list(events),
        }
        if self.run.leg_count > 1:
            notes["leg"] = leg
        encoded = _encode(notes)
        arrays: dict[str, NDArray[Any]] = {
            _JSON: encoded,
            "positions": positions.astype(np.float32),
        }
        if det_f is not None:
            arrays["det_f"] = det_f.astype(np.float32)
        with _writing(self.path), replacing(self._frame_path(frame)) as path:
            _save_arrays(path, arrays)
        self._notes.append(_decode(encoded))
        self.frame_count += 1

    def save_checkpoint(
        self, frame: int, arrays: Mapping[str, NDArray[Any]], scalars: Mapping[str, Any]
    ) -> None:
        """Replace the checkpoint by the state after a finished frame, see `Checkpoint`.

        Raises:
            ResultError: The disk refuses; the previous checkpoint stands.
            ValueError: The frame is not finished, or an array holds objects.
        """
        if not 0 <= frame < self.frame_count:
            raise ValueError(f"checkpoint after frame {frame} of {self.frame_count}")
        encoded = _encode({"frame": frame, "scalars": dict(scalars)})
        with _writing(self.path), replacing(self.path / _CHECKPOINT) as path:
            _save_arrays(path, {_JSON: encoded, **arrays})

    def load_checkpoint(self) -> Checkpoint | None:
        """The last checkpoint, or None where the run was killed before the first.

        Raises:
            ResultError: It is damaged.
        """
        path = checkpoint_path(self.result_path)
        return read_checkpoint(path) if path.exists() else None

    def truncate_after(self, frame: int) -> None:
        """Forget all frames beyond one (-1: all), before the run goes on from its checkpoint.

        Raises:
            ResultError: That frame is not there, or the disk refuses.
        """
        if frame >= self.frame_count:
            raise _damaged(self.path, f"has a checkpoint after frame {frame} but not that frame")
        with _writing(self.path):
            while self.frame_count > frame + 1:
                self._frame_path(self.frame_count - 1).unlink()
                self._notes.pop()
                self.frame_count -= 1

    def remove(self) -> None:
        """Delete the run directory, once the result file is written.

        Raises:
            ResultError: The disk refuses.
        """
        with _writing(self.path):
            _clear(self.path)
            self.close()
            shutil.rmtree(self.path)

    def close(self) -> None:
        """Free the lock; the directory stays."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read_notes(self) -> list[Json]:
        notes: list[Json] = []
        while (path := self._frame_path(len(notes))).exists():
            with _stored(path) as arrays:
                notes.append(_decode(arrays[_JSON]))
        return notes


def read_checkpoint(path: Path) -> Checkpoint:
    """A checkpoint.

    Raises:
        ResultError: It is absent or damaged.
    """
    arrays = _load_arrays(path)
    with _reading(path):
        state = _decode(arrays.pop(_JSON))
        return Checkpoint(state["frame"], arrays, state["scalars"])


def _read_run(path: Path) -> RunRecord:
    """The record in a run directory."""
    with _reading(path / _RUN):
        document: Json = json.loads((path / _RUN).read_text(encoding="utf-8"))
        return RunRecord.restore(document, _load_arrays(path / _ARRAYS))


def _lock(path: Path) -> BinaryIO:
    lock = acquire(path / "lock")
    if lock is None:
        raise ResultError(
            f"Another process is writing the run at {path}.",
            "Wait for it to end, or choose another result file with `out`.",
        )
    return lock


def _clear(path: Path) -> None:
    (path / _RUN).unlink(missing_ok=True)  # first: without it, what is left is no run
    for file in path.iterdir():
        if file.name != "lock":
            file.unlink()


def _check_same(path: Path, stored: Json, wanted: Json) -> None:
    for key in sorted(stored.keys() | wanted.keys()):
        if stored.get(key) != wanted.get(key):
            raise ResultError(
                f"The unfinished run at {path} has a different {_difference(key, stored, wanted)}.",
                "Resume it with the same inputs, options and software, or delete that directory.",
            )


def _difference(key: str, stored: Any, wanted: Any) -> str:
    """Dotted path of the first value that differs below a key, with both values if short."""
    old, new = stored.get(key), wanted.get(key)
    if isinstance(old, dict) and isinstance(new, dict):
        inner = next(name for name in sorted(old | new) if old.get(name) != new.get(name))
        return f"{key}.{_difference(inner, old, new)}"
    return f"{key} ({old!r}, now {new!r})" if len(f"{old!r}{new!r}") < 160 else key


def _save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    with _stored(path) as arrays:
        return dict(arrays)


@contextmanager
def _stored(path: Path) -> Iterator[Mapping[str, NDArray[Any]]]:
    """The arrays of a file, each read when asked for."""
    with _reading(path), path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        yield arrays


def _encode(value: Json) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(value, default=_plain).encode(), np.uint8)


def _decode(text: NDArray[np.uint8]) -> Json:
    value: Json = json.loads(text.tobytes())
    return value


def _plain(value: Any) -> Any:
    """NumPy values as JSON."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")


def _damaged(path: Path, how: str) -> DamagedError:
    return DamagedError(f"{path} {how}.", "Delete the run directory and start the run again.")


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, *UNREADABLE) as error:
        raise _damaged(path, f"cannot be read ({error})") from error


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DiskSpaceError(
            f"Cannot write to {path} ({error.strerror or error}).",
            "Free some disk space or choose another place with `out`, then resume.",
        ) from error
