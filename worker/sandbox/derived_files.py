"""What is computed from a job's frames and kept beside them: surfaces and exports."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from chamfer_morph.schemas import Sha256, Units
from morph_engine.files import replacing


@dataclass(frozen=True, eq=False)
class StoredSurface:
    """A surface as it lies on the disk.

    Attributes:
        vertices: Corner positions [grid units], shape [V, 3], float64.
        faces: Vertex indices, shape [F, 3], int32.
        report: `watertight`, `bodies`, `largest` (share of the largest in the area), `volume`
            [dx^3], and, where the target is a mesh, `deviation` [dx] as of `surface.deviation`.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    report: dict[str, Any]

    @classmethod
    def load(cls, path: Path) -> StoredSurface:
        """Read one that is there."""
        with np.load(path, allow_pickle=False) as arrays:
            report = json.loads(arrays["report"].tobytes())
            return cls(arrays["vertices"], arrays["faces"], report)

    def save(self, path: Path) -> None:
        """Write it as a whole."""
        report = np.frombuffer(json.dumps(self.report).encode(), np.uint8)
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, vertices=self.vertices, faces=self.faces, report=report)


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
    fps: float | None
    units: Units
    fields: list[str]


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
