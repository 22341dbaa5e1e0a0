"""Finished runs on the disk: one JSON file each, beside the result file it was taken from.

A record is found again as long as configuration and meshes are the same. One that is torn, of
another configuration, of a failed run or of one under way counts as absent.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, ValidationError, model_validator

from chamfer_morph.reproduction.runs.run import Run
from morph_engine.config import MorphConfig, stored_config
from morph_engine.errors import ResultError
from morph_engine.files import replacing
from morph_engine.metrics.summary import summarize
from morph_engine.results.provenance import Provenance
from morph_engine.results.run_record import software_versions
from morph_engine.results.trajectory import Trajectory

CURVES = (
    "s2t", "t2s", "two_sided", "hausdorff", "f1", "overlap_01", "overlap_h10", "many_to_one",
    "targets_used", "loss_physics", "loss_chamfer", "max_speed",
)  # fmt: skip
"""Metrics kept for every frame; the result file has all of them."""


def _stored_config(document: Any) -> MorphConfig | None:
    return stored_config(document) if document else None


class Record(BaseModel, frozen=True, ser_json_inf_nan="constants"):
    """What a run has come to, and by what.

    Units are those of `morph_engine.metrics.definitions.METRICS`. Records of version 0.1.0 name of
    their provenance the CPU time alone.
    """

    run: Run
    digest: str = Field(description="Of configuration and meshes, see `Run.digest`.")
    status: Literal["complete", "failed", "unfinished"]
    problem: str = Field("", description="Why it failed.")
    config: Annotated[MorphConfig | None, BeforeValidator(_stored_config)] = Field(
        None, description="Resolved configuration; none if the run failed."
    )
    meshes: dict[str, str] = Field(default_factory=dict, description="SHA-256 by role.")
    software: dict[str, str] = Field(default_factory=software_versions)
    provenance: Provenance = Field(Provenance(), description="Of the finished frames.")
    particle_count: int = 0
    target_count: int = 0
    frames: int = 0
    metrics: dict[str, float] = Field(
        default_factory=dict, description="Of the last frame and of all, see `summarize`."
    )
    curves: dict[str, list[float]] = Field(default_factory=dict)
    ends: list[dict[str, float]] = Field(
        default_factory=list,
        description="The last frame against the mesh, for each draw of points.",
    )

    @model_validator(mode="before")
    @classmethod
    def _of_version_0_1_0(cls, document: Any) -> Any:
        if not isinstance(document, dict) or "cpu_seconds" not in document:
            return document
        provenance = {"cpu_seconds": document["cpu_seconds"]}
        return {"provenance": provenance, **document}

    @property
    def is_complete(self) -> bool:
        """Whether it has numbers."""
        return self.status == "complete"


class Store:
    """A folder of records and result files.

    Args:
        folder: The folder, made when first written to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs_folder: Path = folder / "runs"

    def record_path(self, run: Run) -> Path:
        """Where the record of a run lies."""
        return self.runs_folder / f"{run.id}.json"

    def result_path(self, run: Run) -> Path:
        """Where its frames lie."""
        return self.runs_folder / f"{run.id}.vtkhdf"

    def log_path(self, run: Run) -> Path:
        """Where the process that computed it wrote its messages."""
        return self.runs_folder / f"{run.id}.log"

    def read(self, run: Run, digest: str) -> Record | None:
        """The record of a run, complete or failed; None if absent, torn or of another digest."""
        try:
            text = self.record_path(run).read_bytes()
            record = Record.model_validate_json(text)
        except (OSError, ValidationError):
            return None
        return record if record.digest == digest else None

    def find(self, run: Run, digest: str) -> Record | None:
        """The record of a run that has been completed with this digest."""
        record = self.read(run, digest)
        return record if record is not None and record.is_complete else None

    def progress(self, run: Run, digest: str) -> Provenance:
        """What the finished frames of a run have cost that is not complete; empty without them."""
        record = self.read(run, digest)
        return Provenance() if record is None or record.is_complete else record.provenance

    def save(self, record: Record) -> None:
        """Write a record, as a whole.

        Raises:
            ResultError: The disk refuses.
        """
        path = self.record_path(record.run)
        try:
            self.runs_folder.mkdir(parents=True, exist_ok=True)
            with replacing(path) as temporary:
                temporary.write_text(record.model_dump_json(indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise ResultError(
                f"Cannot write {path} ({error.strerror or error}).",
                "Free some disk space, or choose another folder with --results.",
            ) from error

    def save_progress(self, run: Run, digest: str, provenance: Provenance) -> None:
        """Note that a run is under way, and what its finished frames have cost."""
        self.save(Record(run=run, digest=digest, status="unfinished", provenance=provenance))

    def save_failure(self, run: Run, digest: str, problem: str) -> Record:
        """Note that a run failed, and why; what it has cost so far is kept."""
        provenance = self.progress(run, digest)
        record = Record(
            run=run, digest=digest, status="failed", problem=problem, provenance=provenance
        )
        self.save(record)
        return record

    def trajectory(self, run: Run) -> Trajectory:
        """The result file of a run, open for reading.

        Raises:
            ResultError: It is absent or damaged.
        """
        return Trajectory(self.result_path(run))


def record_from_result(run: Run, digest: str, result: Trajectory, provenance: Provenance) -> Record:
    """The record of a finished run, taken from its result file.

    Raises:
        ResultError: The file is damaged.
    """
    document = result.run.document()
    return Record(
        run=run,
        digest=digest,
        status="complete",
        config=result.config,
        meshes={role: document[role]["sha256"] for role in ("source", "target")},
        software=result.software,
        provenance=provenance,
        particle_count=result.particle_count,
        target_count=len(result.target_points),
        frames=result.frame_count,
        metrics=summarize(result),
        curves={
            name: [float(f"{value:.6g}") for value in result.metrics[name]]
            for name in CURVES
            if name in result.metrics and not np.isnan(result.metrics[name]).all()
        },
    )
