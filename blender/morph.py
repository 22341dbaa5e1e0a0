"""A morph from two mesh files to an animated GLB, in a thread of its own: no Blender in here."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from .service import Json, Service, ServiceError

SECONDS_BETWEEN_LOOKS = 0.5
SECONDS_BETWEEN_TRIES = 2.0
PATIENCE_SECONDS = 120.0
"""How long a service may be away before the morph is given up."""

COMPUTED = 0.85
"""Share of the progress bar at which all frames are computed and the mesh is made of them."""

STAGES = {
    "filling": "Filling the shapes",
    "preparing": "Matching the shapes",
    "computing": "Computing the first frame",
}
UNFINISHED = {"queued", "running"}

T = TypeVar("T")


@dataclass(frozen=True)
class Request:
    """What is to be made.

    Attributes:
        source: File of the mesh that the morph begins with.
        target: File of the mesh that it ends with.
        result: Where the animated GLB goes.
        preset: Configuration to start from.
        detail: Particles per cell edge.
        frames: Simulated frames.
        seconds: Playing time [s].
        fps: Pictures per second.
        snap: Whether the ends get the details of the meshes.
    """

    source: Path
    target: Path
    result: Path
    preset: str
    detail: int
    frames: int
    seconds: float
    fps: float
    snap: bool


class Morph:
    """A request on its way.

    Attributes:
        stage: What goes on, in words.
        progress: Share that is done, 0 to 1.
        error: Why it has failed; empty as long as it has not.
    """

    def __init__(self, service: Service, request: Request) -> None:
        self.stage: str = "Sending the meshes"
        self.progress: float = 0.0
        self.error: str = ""
        self._service = service
        self._request = request
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def cancel(self) -> None:
        """End it soon."""
        self._cancelled.set()

    def wait(self) -> None:
        """Until it has ended."""
        self._thread.join()

    @property
    def is_running(self) -> bool:
        """Whether it goes on."""
        return self._thread.is_alive()

    @property
    def is_cancelled(self) -> bool:
        """Whether it was to end early."""
        return self._cancelled.is_set()

    def _run(self) -> None:
        try:
            job = self._submit()
            if self._follow(job):
                self._fetch(job)
        except (ServiceError, OSError) as error:
            self.error = str(error)

    def _submit(self) -> str:
        request = self._request
        source, target = (
            {"mesh": self._service.upload(mesh)} for mesh in (request.source, request.target)
        )
        return self._service.submit(
            {
                "source": source,
                "target": target,
                "preset": request.preset,
                "frames": request.frames,
                "overrides": {"sampling.points_per_cell_edge": request.detail},
                "name": f"{request.source.stem} to {request.target.stem}",
            }
        )

    def _follow(self, job: str) -> bool:
        """Wait for the job; returns whether there is a result."""
        while (shown := self._patiently(self._service.job, job))["state"] in UNFINISHED:
            self._tell(shown)
            if self._cancelled.wait(SECONDS_BETWEEN_LOOKS):
                self._service.cancel(job)
                return False
        if shown["state"] != "succeeded":
            problem = shown.get("problem") or {"cause": f"The job has {shown['state']}."}
            raise ServiceError(f"{problem['cause']} {problem.get('remedy', '')}".strip())
        return True

    def _patiently(self, ask: Callable[..., T], *arguments: object) -> T:
        """Ask the service, and again for a while if it does not answer."""
        deadline = time.monotonic() + PATIENCE_SECONDS
        while True:
            try:
                return ask(*arguments)
            except ServiceError as error:
                late = time.monotonic() > deadline
                if late or not error.passes or self._cancelled.is_set():
                    raise
            self._cancelled.wait(SECONDS_BETWEEN_TRIES)

    def _tell(self, job: Json) -> None:
        progress = job["progress"]
        if job["state"] == "queued":
            self.stage = "Waiting for other jobs"
        elif progress["frame"]:
            self.stage = f"Frame {progress['frame']} of {progress['frames']}"
        else:
            self.stage = STAGES.get(progress.get("stage") or "", "Starting")
        self.progress = COMPUTED * progress["frame"] / max(progress["frames"], 1)

    def _fetch(self, job: str) -> None:
        request, service = self._request, self._service
        self.stage, self.progress = "Making one mesh that moves", COMPUTED
        export = self._patiently(
            service.begin_export,
            job,
            {
                "format": "glb",
                "tracked": True,
                "snap": request.snap,
                "seconds": request.seconds,
                "fps": request.fps,
            },
        )
        while export["state"] == "running":
            self.progress = COMPUTED + (1 - COMPUTED) * export["progress"]
            if self._cancelled.wait(SECONDS_BETWEEN_LOOKS):
                return
            export = self._patiently(service.export, export)
        if export["state"] != "ready":
            problem = export["problem"] or {"cause": "The mesh could not be made."}
            raise ServiceError(f"{problem['cause']} {problem.get('remedy', '')}".strip())
        self._patiently(service.download, export["links"]["file"], request.result)
        self.progress = 1.0
