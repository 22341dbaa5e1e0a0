"""What is computed from a job's frames and kept beside them: surfaces and exports."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from chamfer_morph import schemas
from chamfer_morph.schemas import Easing, Repeat, Sha256, Units
from morph_engine.files import replacing
from morph_engine.results.timeline import Timing

if TYPE_CHECKING:
    from morph_engine.export import Content
    from morph_engine.rendering.picture_options import PictureOptions


@dataclass(frozen=True, eq=False)
class StoredSurface:
    """A surface as it lies on the disk.

    Attributes:
        vertices: Corner positions [grid units], shape [V, 3], float64.
        faces: Vertex indices, shape [F, 3], int32.
        report: `watertight`, `bodies`, `largest` (share of the largest in the area), `volume`
            [dx^3], and, where the target is a mesh, `deviation` [dx] as of `surface.deviation`.
        colors: Colours of the corners, sRGB, shape [V, 3], uint8. None where the shapes have none,
            and until the job has ended, since colours lead to what the matter becomes.
        snapped: The corners of the same surface snapped to the mesh of source or target [grid
            units], shape [V, 3], float64. None far from both, and until the job has ended.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    report: dict[str, Any]
    colors: NDArray[np.uint8] | None = None
    snapped: NDArray[np.float64] | None = None

    @classmethod
    def load(cls, path: Path) -> StoredSurface:
        """Read one that is there."""
        with np.load(path, allow_pickle=False) as arrays:
            report = json.loads(arrays["report"].tobytes())
            more = arrays.get("colors"), arrays.get("snapped")
            return cls(arrays["vertices"], arrays["faces"], report, *more)

    def save(self, path: Path) -> None:
        """Write it as a whole."""
        report = np.frombuffer(json.dumps(self.report).encode(), np.uint8)
        arrays: dict[str, NDArray[Any]]
        with replacing(path) as temporary, temporary.open("wb") as file:
            arrays = {"vertices": self.vertices, "faces": self.faces, "report": report}
            if self.colors is not None:
                arrays["colors"] = self.colors
            if self.snapped is not None:
                arrays["snapped"] = self.snapped
            np.savez(file, allow_pickle=False, **arrays)

    @classmethod
    def is_there(cls, path: Path, result: Path) -> bool:
        """Whether there is one, with all that it can have by now.

        Args:
            path: Where it is kept.
            result: The job's result file, whether it is there or not.
        """
        try:
            made = path.stat().st_mtime_ns
        except FileNotFoundError:
            return False
        return not result.is_file() or made > result.stat().st_mtime_ns


class ExportOptions(BaseModel, frozen=True, extra="forbid"):
    """What to export.

    Attributes:
        id: Tells this export from others of the job.
        name: What to call the file elsewhere, without its ending.
        format: As `morph_engine.export.export` takes it, and so are the others.
    """

    id: str
    name: str
    format: str
    frames: list[int] | None
    surface: bool
    snap: bool
    tracked: bool
    texture: int | None = None
    fps: float | None
    seconds: float | None = None
    hold: float | None = None
    easing: Easing | None = None
    repeat: Repeat | None = None
    picture: schemas.PictureOptions | None = None
    units: Units
    fields: list[str]

    @property
    def timing(self) -> Timing | None:
        """How it is played; None where nothing of that is asked for.

        Raises:
            ConfigError: A number is out of range.
        """
        return Timing.of(
            fps=self.fps,
            seconds=self.seconds,
            hold=self.hold,
            easing=self.easing,
            repeat=self.repeat,
        )

    @property
    def content(self) -> Content:
        """What it holds, as `morph_engine.export` takes it.

        Raises:
            ConfigError: A number is out of range.
        """
        return {
            "frames": self.frames,
            "surface": self.surface,
            "snap": self.snap,
            "tracked": self.tracked,
            "texture": self.texture,
            "fps": self.fps,
            "timing": self.timing,
            "picture": _for_engine(self.picture) if self.picture else None,
            "fields": self.fields,
        }


def _for_engine(asked: schemas.PictureOptions) -> PictureOptions:
    """What is asked for, as the engine takes it.

    Raises:
        ConfigError: Two camera keys are at the same time.
    """
    from morph_engine.rendering.camera_path import CameraKey, CameraPath, View
    from morph_engine.rendering.picture_options import PictureOptions

    keys = (
        CameraKey(key.share, View(key.azimuth, key.elevation, key.zoom))
        for key in asked.camera_keys
    )
    return PictureOptions(
        size=(asked.width, asked.height),
        camera=CameraPath(asked.camera, tuple(keys)),
        background=asked.background,
        material=asked.look,
    )


class StoredExport(BaseModel):
    """An export as it lies on the disk.

    Attributes:
        file: Name of its file, beside this document.
        name: What to call the file elsewhere.
        media_type: Its media type.
        size_bytes: Its size.
        sha256: Its digest.
    """

    file: str
    name: str
    media_type: str
    size_bytes: int
    sha256: Sha256

    @classmethod
    def find(cls, folder: Path, export_id: str) -> StoredExport | None:
        """One that is whole, or None."""
        try:
            text = (folder / f"{export_id}.json").read_text(encoding="utf-8")
            return cls.model_validate_json(text)
        except (OSError, ValueError):
            return None

    def remove(self, folder: Path, export_id: str) -> None:
        """Remove it, the document first, so that it is whole as long as it is found."""
        (folder / f"{export_id}.json").unlink(missing_ok=True)
        (folder / self.file).unlink(missing_ok=True)
