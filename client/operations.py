"""Everything a client can ask of the service."""

from __future__ import annotations

import io
import uuid
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import quote

import httpx
from anyio import sleep
from pydantic import BaseModel, ValidationError

from chamfer_morph import schemas
from chamfer_morph.client.connection import DEFAULT_TIMEOUT_SECONDS, Connection, FileContent
from chamfer_morph.client.download import download
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.client.execution import operation
from chamfer_morph.client.job_events import follow
from chamfer_morph.schemas import (
    BuiltInShape,
    Delivery,
    DeliveryPage,
    Easing,
    Event,
    Export,
    ExportFormat,
    ExportRequest,
    Fit,
    ForkRequest,
    Job,
    JobPage,
    JobRequest,
    Key,
    KeyRequest,
    Mesh,
    MeshPage,
    MeshShape,
    NewKey,
    NewShareLink,
    NewWebhook,
    ParticleField,
    Playback,
    QueueStatus,
    Repeat,
    Resource,
    Shape,
    ShareLink,
    SurfaceFormat,
    Sweep,
    SweepRequest,
    Units,
    Webhook,
    WebhookRequest,
    WorkerStatus,
)
from morph_engine.errors import ConfigError, MeshError, ResultError, unknown_name
from morph_engine.files import file_sha256

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Model = TypeVar("Model", bound=BaseModel)
T = TypeVar("T")
ShapeLike = str | Path | Shape

TEXT_PREFIX = "text:"
PAGE_SIZE = 100
WORKERS_PAGE = 1000
EXPORT_SECONDS = 0.5
"""How often to look whether an export is ready."""

UPLOAD_TIMEOUT = httpx.Timeout(30.0, read=180.0)
"""The service reads a mesh before it answers [s]."""

COMPUTING_TIMEOUT = httpx.Timeout(30.0, read=900.0)
"""The service computes a surface or fills a shape before it answers, maybe after others [s]."""


class Operations:
    """What both clients can do; everything raises ServiceError when the service refuses."""

    def __init__(
        self,
        server: str | None = None,
        *,
        key: str | None = None,
        timeout_seconds: float = DEFAULT_TIMEOUT_SECONDS,
    ) -> None:
        self._connection = Connection(server, key, timeout_seconds)

    @property
    def server(self) -> str:
        """Address of the service."""
        return self._connection.server

    # meshes

    @operation
    async def upload_mesh(self, path: str | Path) -> Mesh:
        """Upload a mesh file; what is there already is not sent again.

        Raises:
            MeshError: The file cannot be read.
        """
        path = Path(path)
        try:
            digest, size = file_sha256(path), path.stat().st_size
        except OSError as error:
            raise MeshError(
                f"{path} cannot be read ({error.strerror}).", "Check the path of the mesh."
            ) from error
        try:
            return await self._get(Mesh, "meshes", digest)
        except ServiceError as error:
            if error.status != 404:
                raise
        answer = await self._connection.send(
            "POST",
            "/meshes",
            params={"name": path.name},
            content=FileContent(path),
            headers={"Content-Type": "application/octet-stream", "Content-Length": str(size)},
            timeout=UPLOAD_TIMEOUT,
            repeatable=True,
        )
        return self._connection.parse(Mesh, answer.content)

    @operation
    def meshes(self) -> AsyncGenerator[Mesh, None]:
        """Your meshes, the newest first."""
        return self._pages(MeshPage, "meshes")

    @operation
    async def mesh(self, mesh_id: str) -> Mesh:
        """One mesh."""
        return await self._get(Mesh, "meshes", mesh_id)

    @operation
    async def delete_mesh(self, mesh_id: str) -> None:
        """Delete a mesh that no unfinished job uses."""
        await self._delete("meshes", mesh_id)

    # jobs

    @operation
    async def submit(
        self,
        source: ShapeLike,
        target: ShapeLike | Sequence[ShapeLike],
        *,
        preset: str = "fast",
        overrides: Mapping[str, Any] | None = None,
        method: str | None = None,
        frames: int | None = None,
        seed: int | None = None,
        name: str = "",
        device: schemas.Device = "auto",
        priority: int = 100,
        timeout_seconds: float | None = None,
        reuse: bool = False,
        states_every: int = 0,
        idempotency_key: str | None = None,
    ) -> Job:
        """Have a morph computed.

        Args:
            source: Where the particles come from: a file, which is uploaded, or a built-in shape.
            target: What they are to become; of several in a list, one after the other.
            preset: Configuration to start from.
            overrides: Settings by dotted path.
            method: Short for the override `method`.
            frames: Short for the override `frames`; of the way to each target.
            seed: Short for the override `seed`.
            name: For your own use.
            device: Where to compute.
            priority: 1 to 1000; smaller runs earlier among your jobs.
            timeout_seconds: Stop after so long [s].
            reuse: Take the result of an equal job of yours, if one has succeeded.
            states_every: Frames between two states that are kept for forks; 0 for none.
            idempotency_key: Calls with the same key make one job; if None, a new key, which
                holds for the repetitions within this call.

        Returns:
            The job, usually queued.

        Raises:
            ConfigError: A name or a value is none that can be used; told before a file is sent.
            MeshError: A file cannot be read.
        """
        targets: list[Any] = list(target) if isinstance(target, list | tuple) else [target]
        shapes = [source, *targets]
        await self._check_names(shapes, preset, [] if method is None else [method])
        first, *via, last = [await self._shape(shape) for shape in shapes]
        body = _validated(
            JobRequest,
            source=first,
            via=via,
            target=last,
            preset=preset,
            overrides=dict(overrides or {}),
            method=method,
            frames=frames,
            seed=seed,
            name=name,
            device=device,
            priority=priority,
            timeout_seconds=timeout_seconds,
            reuse=reuse,
            states_every=states_every,
        )
        key = idempotency_key or str(uuid.uuid4())
        return await self._post(Job, "jobs", body=body, idempotency_key=key)

    @operation
    def jobs(
        self,
        *,
        state: str | None = None,
        method: str | None = None,
        sweep: str | None = None,
        owner: str | None = None,
    ) -> AsyncGenerator[Job, None]:
        """Jobs, the newest first; page after page is fetched as you iterate."""
        return self._pages(JobPage, "jobs", state=state, method=method, sweep=sweep, owner=owner)

    @operation
    async def job(self, job_id: str, *, wait_for_service: bool = False) -> Job:
        """A job as it stands; a service that is away can be waited for, about a minute."""
        return await self._get(Job, "jobs", job_id, wait_for_service=wait_for_service)

    @operation
    async def cancel(self, job_id: str) -> Job:
        """Stop a job; its finished frames stay."""
        return await self._post(Job, "jobs", job_id, "cancel", repeatable=True)

    @operation
    async def put_first(self, job_id: str) -> Job:
        """Start a queued job before all others of its owner."""
        return await self._post(Job, "jobs", job_id, "next", repeatable=True)

    @operation
    async def resume(self, job_id: str) -> Job:
        """Let a job that did not succeed go on after its last finished frame."""
        return await self._post(Job, "jobs", job_id, "resume")

    @operation
    async def fork(
        self,
        job_id: str,
        frame: int | None = None,
        *,
        overrides: Mapping[str, Any] | None = None,
        name: str = "",
        priority: int = 100,
        timeout_seconds: float | None = None,
        states_every: int = 0,
        idempotency_key: str | None = None,
    ) -> Job:
        """A new job that begins with the frames of another and goes on with other settings.

        Args:
            job_id: The other job.
            frame: Index of the last frame that both have in common; None for the last one after
                which there is a full state.
            overrides: Settings by dotted path, in place of the other job's.
            name: For your own use.
            priority: 1 to 1000; smaller runs earlier among your jobs.
            timeout_seconds: Stop after so long [s].
            states_every: Frames between two states that are kept for forks; 0 for none.
            idempotency_key: As of `submit`.
        """
        body = _validated(
            ForkRequest,
            frame=frame,
            overrides=dict(overrides or {}),
            name=name,
            priority=priority,
            timeout_seconds=timeout_seconds,
            states_every=states_every,
        )
        key = idempotency_key or str(uuid.uuid4())
        return await self._post(Job, "jobs", job_id, "fork", body=body, idempotency_key=key)

    @operation
    async def retry(self, job_id: str) -> Job:
        """Compute a finished job again from its beginning."""
        return await self._post(Job, "jobs", job_id, "retry")

    @operation
    async def delete(self, job_id: str) -> None:
        """Delete a finished job and its result."""
        await self._delete("jobs", job_id)

    @operation
    def events(self, job_id: str, *, after: int = 0) -> AsyncGenerator[Event, None]:
        """Events of a job with an id above `after` as they happen, until it is finished.

        A lost connection is taken up again after the last event.
        """
        return follow(self._connection, _path("jobs", job_id, "events"), after)

    @operation
    async def wait(self, job_id: str) -> Job:
        """The job once it is finished, however it ended."""
        async for _ in follow(self._connection, _path("jobs", job_id, "events"), after=0):
            pass
        return await self._get(Job, "jobs", job_id, wait_for_service=True)

    @operation
    async def queue(self) -> QueueStatus:
        """How many of your jobs wait and run, and whether you have paused them."""
        return await self._get(QueueStatus, "queue")

    @operation
    async def pause_queue(self) -> QueueStatus:
        """Start no more of your jobs; those that run go on."""
        return await self._post(QueueStatus, "queue", "pause", repeatable=True)

    @operation
    async def unpause_queue(self) -> QueueStatus:
        """Start your jobs again, as if they were submitted now."""
        return await self._post(QueueStatus, "queue", "unpause", repeatable=True)

    # results

    @operation
    async def download(self, job_id: str, path: str | Path) -> Path:
        """Fetch the result of a job into a file, which appears whole or not at all.

        What an interrupted download left beside the file is completed, not fetched again. The
        file replaces one that is there.

        Raises:
            ResultError: What arrived is damaged.
        """
        await download(self._connection, _path("jobs", job_id, "result"), Path(path))
        return Path(path)

    @operation
    async def frame(self, job_id: str, index: int = -1) -> NDArray[np.float32]:
        """Particle positions of a frame [dx], shape [particle_count, 3], float32.

        The job may still run. Frames count from 0; -1 is the last one finished.
        """
        return await self._get_points("jobs", job_id, "frames", str(index))

    @operation
    async def source(self, job_id: str) -> NDArray[np.float32]:
        """Particle positions before the first frame [dx], shape [particle_count, 3], float32."""
        return await self._get_points("jobs", job_id, "source")

    @operation
    async def colors(self, job_id: str) -> NDArray[np.uint8]:
        """Colours of the particles in each shape of a morph, sRGB, shape [shapes, n, 3], uint8.

        There are 0 shapes where none has colours. `morph_engine.results.colors` tells how they are
        blended from one shape to the next.
        """
        import numpy as np

        answer = await self._connection.get(
            _path("jobs", job_id, "colors"), timeout=COMPUTING_TIMEOUT
        )
        count = int(answer.headers["Morph-Particles"])
        return np.frombuffer(answer.content, np.uint8).reshape(-1, count, 3)

    @operation
    async def target(self, job_id: str) -> NDArray[np.float32]:
        """Target points [dx], shape [target_count, 3], float32."""
        return await self._get_points("jobs", job_id, "target")

    @operation
    async def field(self, job_id: str, name: str, index: int = -1) -> NDArray[np.float32]:
        """A field of a frame, a value per particle, shape [particle_count], float32.

        `fields` has the names; frames are those of `frame`.
        """
        import numpy as np

        path = _path("jobs", job_id, "frames", str(index), "fields", name)
        answer = await self._connection.get(path, format="f32")
        return np.frombuffer(answer.content, "<f4").astype(np.float32)

    @operation
    async def playback(
        self,
        job_id: str,
        *,
        seconds: float | None = None,
        fps: float = 30.0,
        hold: float = 0.0,
        easing: Easing = "in-out",
        repeat: Repeat = "none",
    ) -> Playback:
        """Which frame of a finished job a player shows when, in a time of its own.

        Args:
            job_id: The job.
            seconds: Duration, with the rests [s]; as long as all frames, and the rests, if None.
            fps: Pictures per second.
            hold: Rest at each shape [s].
            easing: Pace between two shapes.
            repeat: Whether it ends as it begins, or plays to the end and back.
        """
        return await self._get(
            Playback,
            "jobs",
            job_id,
            "playback",
            seconds=seconds,
            fps=fps,
            hold=hold,
            easing=easing,
            repeat=repeat,
        )

    @operation
    async def surface(
        self,
        job_id: str,
        index: int = -1,
        *,
        format: SurfaceFormat = "glb",
        units: Units = "user",
    ) -> bytes:
        """A closed mesh around the particles of a frame, as a file.

        It is computed when it is first asked for, which takes seconds, or minutes where there are
        millions of particles or others have asked before.

        Args:
            job_id: The job, which may still run.
            index: Frame, 0-based; -1 is the last one finished.
            format: glb, ply, obj or stl.
            units: Coordinates of the files (user), of one of them, or grid units.
        """
        path = _path("jobs", job_id, "frames", str(index), "surface")
        answer = await self._connection.get(
            path, timeout=COMPUTING_TIMEOUT, format=format, units=units
        )
        return answer.content

    @operation
    async def thumbnail(self, job_id: str) -> bytes:
        """A WebP picture of the newest frame, 240 x 180 pixels."""
        return (await self._connection.get(_path("jobs", job_id, "thumbnail"))).content

    @operation
    async def export(
        self,
        job_id: str,
        path: str | Path,
        format: str,
        *,
        frames: Iterable[int] | None = None,
        surface: bool = False,
        snap: bool = False,
        tracked: bool = False,
        texture: int | None = None,
        fps: float | None = None,
        seconds: float | None = None,
        hold: float | None = None,
        easing: Easing | None = None,
        repeat: Repeat | None = None,
        picture: schemas.PictureOptions | None = None,
        units: Units = "user",
        fields: Iterable[str] = (),
    ) -> Path:
        """Have a finished job written in another format, and fetch it into a file.

        Args:
            job_id: The job.
            path: The file, which appears whole or not at all and replaces one that is there.
            format: Name of a format, see `export_formats`.
            frames: 0-based, negative from the end; None means all. Several frames in a format that
                holds one a file come as a zip archive.
            surface: A surface around the particles in their place.
            snap: Draw the surface of the first and last frames to the meshes of both shapes.
            tracked: One mesh through all frames, animated in one file.
            texture: Edge of the picture that holds the colours of a tracked GLB [pixels].
            fps: Frames per second of an animation: 24 by default, 12 in videos, 30 of a given time.
            seconds: Duration of what is played, with its rests [s].
            hold: Rest at each shape [s].
            easing: Pace between two shapes.
            repeat: Whether it ends as it begins, or plays to the end and back.
            picture: How videos and pictures are drawn.
            units: Coordinates of the files (user), of one of them, or grid units.
            fields: Names of fields to carry along.

        Raises:
            ResultError: The export has failed, or what arrived is damaged.
        """
        body = _validated(
            ExportRequest,
            format=format,
            frames=None if frames is None else list(frames),
            surface=surface,
            snap=snap,
            tracked=tracked,
            texture=texture,
            fps=fps,
            seconds=seconds,
            hold=hold,
            easing=easing,
            repeat=repeat,
            picture=picture,
            units=units,
            fields=list(fields),
        )
        exports = ("jobs", job_id, "exports")
        export = await self._post(Export, *exports, body=body, repeatable=True)
        while export.state == "running":
            await sleep(EXPORT_SECONDS)
            try:
                export = await self._get(Export, *exports, export.id)
            except ServiceError as error:
                if error.status != 404:
                    raise
                # a restart has ended it: the same request is the same export
                export = await self._post(Export, *exports, body=body, repeatable=True)
        if export.problem is not None:
            raise ResultError(export.problem.cause, export.problem.remedy)
        await download(self._connection, _path(*exports, export.id, "file"), Path(path))
        return Path(path)

    @operation
    async def metrics(self, job_id: str) -> list[dict[str, float]]:
        """Metrics of every finished frame, and what each took [s]."""
        return await self._get(list[dict[str, float]], "jobs", job_id, "metrics")

    @operation
    async def config(self, job_id: str) -> dict[str, Any]:
        """The resolved configuration of a job."""
        return await self._get(dict[str, Any], "jobs", job_id, "config")

    @operation
    async def log(self, job_id: str) -> str:
        """What the engine wrote while it computed a job."""
        return (await self._connection.get(_path("jobs", job_id, "log"))).text

    # sweeps

    @operation
    async def sweep(
        self,
        sources: Iterable[ShapeLike],
        targets: Iterable[ShapeLike],
        *,
        methods: Iterable[str] = ("flow",),
        seeds: Iterable[int] = (42,),
        preset: str = "fast",
        overrides: Mapping[str, Any] | None = None,
        frames: int | None = None,
        name: str = "",
        device: schemas.Device = "auto",
        priority: int = 100,
        timeout_seconds: float | None = None,
        reuse: bool = False,
        states_every: int = 0,
        idempotency_key: str | None = None,
    ) -> Sweep:
        """Have every combination of sources, targets, methods and seeds computed; see `submit`."""
        sources, targets, methods = list(sources), list(targets), list(methods)
        await self._check_names([*sources, *targets], preset, methods)
        body = _validated(
            SweepRequest,
            sources=[await self._shape(source) for source in sources],
            targets=[await self._shape(target) for target in targets],
            methods=methods,
            seeds=list(seeds),
            preset=preset,
            overrides=dict(overrides or {}),
            frames=frames,
            name=name,
            device=device,
            priority=priority,
            timeout_seconds=timeout_seconds,
            reuse=reuse,
            states_every=states_every,
        )
        key = idempotency_key or str(uuid.uuid4())
        return await self._post(
            Sweep, "sweeps", body=body, idempotency_key=key, timeout=COMPUTING_TIMEOUT
        )

    @operation
    async def sweep_status(self, sweep_id: str, *, wait_for_service: bool = False) -> Sweep:
        """A sweep and its table; a service that is away can be waited for, about a minute."""
        return await self._get(Sweep, "sweeps", sweep_id, wait_for_service=wait_for_service)

    # what there is to choose from

    @operation
    async def presets(self) -> list[Resource]:
        """The presets of the service."""
        return await self._get(list[Resource], "presets")

    @operation
    async def methods(self) -> list[Resource]:
        """The methods of the service."""
        return await self._get(list[Resource], "methods")

    @operation
    async def shapes(self) -> list[Resource]:
        """The built-in shapes of the service."""
        return await self._get(list[Resource], "shapes")

    @operation
    async def fields(self) -> list[ParticleField]:
        """What particles can be coloured by."""
        return await self._get(list[ParticleField], "fields")

    @operation
    async def export_formats(self) -> list[ExportFormat]:
        """What jobs can be exported to."""
        return await self._get(list[ExportFormat], "exports", "formats")

    @operation
    async def particles(
        self, shape: ShapeLike, *, points_per_cell_edge: int = 3, fit: Fit = "auto"
    ) -> NDArray[np.float32]:
        """The particles a job would fill a shape with [dx], shape [n, 3], float32.

        Args:
            shape: A file, which is uploaded, or a built-in shape.
            points_per_cell_edge: Lattice points per grid unit and axis, 1 to 8.
            fit: As the setting `sampling.fit`; `auto` takes the other end for a shape like it.

        Raises:
            MeshError: The file cannot be read.
        """
        known = await self._shape(shape)
        place = ("meshes", known.mesh) if isinstance(known, MeshShape) else ("shapes", known.shape)
        query = {"points_per_cell_edge": points_per_cell_edge, "fit": fit}
        return await self._get_points(*place, "particles", **query)

    # share links

    @operation
    async def share(self, job_id: str) -> NewShareLink:
        """Make a link by which others read a job without a key.

        Returns:
            The link; its secret is shown this once. `server` and `path` together are its URL.
        """
        return await self._post(NewShareLink, "jobs", job_id, "share-links")

    @operation
    async def share_links(self, job_id: str) -> list[ShareLink]:
        """The share links of a job, without their secrets."""
        return await self._get(list[ShareLink], "jobs", job_id, "share-links")

    @operation
    async def revoke_share_link(self, job_id: str, link_id: str) -> None:
        """Let a share link show nothing any more."""
        await self._delete("jobs", job_id, "share-links", link_id)

    # webhooks

    @operation
    async def webhooks(self) -> list[Webhook]:
        """Your webhooks, without their secrets."""
        return await self._get(list[Webhook], "webhooks")

    @operation
    async def create_webhook(
        self,
        url: str,
        *,
        states: Iterable[str] = ("succeeded", "failed", "cancelled", "timed_out"),
        secret: str | None = None,
    ) -> NewWebhook:
        """Have a URL told of your jobs.

        Args:
            url: Where to send the messages.
            states: States of your jobs to be told of.
            secret: What messages are signed with; the service makes one if none is given.

        Returns:
            The webhook with its secret, which is shown this once.
        """
        body = _validated(WebhookRequest, url=url, states=list(states), secret=secret)
        return await self._post(NewWebhook, "webhooks", body=body)

    @operation
    async def delete_webhook(self, webhook_id: str) -> None:
        """Tell a webhook nothing any more."""
        await self._delete("webhooks", webhook_id)

    @operation
    async def test_webhook(self, webhook_id: str) -> Delivery:
        """Have a message of the type `test` sent; `deliveries` tells what became of it."""
        return await self._post(Delivery, "webhooks", webhook_id, "test")

    @operation
    def deliveries(self, webhook_id: str) -> AsyncGenerator[Delivery, None]:
        """Messages to a webhook with all attempts to deliver them, the newest first."""
        return self._pages(DeliveryPage, "webhooks", webhook_id, "deliveries")

    # administration

    @operation
    async def keys(self) -> list[Key]:
        """The API keys, without their secrets."""
        return await self._get(list[Key], "keys")

    @operation
    async def create_key(self, name: str, scopes: Iterable[str] = ("read", "submit")) -> NewKey:
        """A new API key; its secret is shown this once."""
        body = _validated(KeyRequest, name=name, scopes=list(scopes))
        return await self._post(NewKey, "keys", body=body)

    @operation
    async def delete_key(self, name: str) -> None:
        """Delete an API key; it is refused from then on."""
        await self._delete("keys", name)

    @operation
    async def workers(self) -> list[WorkerStatus]:
        """The worker slots."""
        found: list[WorkerStatus] = []
        page = None
        while page is None or len(page) == WORKERS_PAGE:
            after = found[-1].id if found else None
            page = await self._get(list[WorkerStatus], "workers", after=after, limit=WORKERS_PAGE)
            found += page
        return found

    @operation
    async def pause_worker(self, worker_id: str) -> WorkerStatus:
        """Let a worker finish its job and start no other."""
        return await self._post(WorkerStatus, "workers", worker_id, "pause", repeatable=True)

    @operation
    async def unpause_worker(self, worker_id: str) -> WorkerStatus:
        """Let a paused worker start jobs again."""
        return await self._post(WorkerStatus, "workers", worker_id, "unpause", repeatable=True)

    # how requests are sent

    async def _get(self, type_: type[T], *path: str, **options: Any) -> T:
        answer = await self._connection.get(_path(*path), **options)
        return self._connection.parse(type_, answer.content)

    async def _get_points(self, *path: str, **query: Any) -> NDArray[np.float32]:
        import numpy as np

        answer = await self._connection.get(
            _path(*path), timeout=COMPUTING_TIMEOUT, format="npy", **query
        )
        points: NDArray[np.float32] = np.load(io.BytesIO(answer.content), allow_pickle=False)
        return points

    async def _pages(
        self, page_type: type[Any], *path: str, **query: Any
    ) -> AsyncGenerator[Any, None]:
        """The items of page after page, each of which is fetched when it is needed."""
        cursor: str | None = ""
        while cursor is not None:
            page = await self._get(
                page_type, *path, limit=PAGE_SIZE, cursor=cursor or None, **query
            )
            for item in page.items:
                yield item
            cursor = page.next_cursor

    async def _post(
        self,
        type_: type[T],
        *path: str,
        body: BaseModel | None = None,
        repeatable: bool = False,
        idempotency_key: str | None = None,
        timeout: httpx.Timeout | None = None,
    ) -> T:
        headers = {"Content-Type": "application/json"} if body else {}
        if idempotency_key:
            headers["Idempotency-Key"] = idempotency_key
        answer = await self._connection.send(
            "POST",
            _path(*path),
            content=body.model_dump_json() if body else None,
            headers=headers,
            repeatable=repeatable or idempotency_key is not None,
            timeout=timeout or httpx.USE_CLIENT_DEFAULT,
        )
        return self._connection.parse(type_, answer.content)

    async def _delete(self, *path: str) -> None:
        await self._connection.send("DELETE", _path(*path))

    async def _check_names(
        self, shapes: Sequence[ShapeLike], preset: str, methods: Sequence[str]
    ) -> None:
        """Refuse a preset or a method that the service has not, before any file is sent to it.

        Raises:
            ConfigError: There is none of that name.
        """
        if not any(map(_is_sent, shapes)):
            return
        for kind, names, listed in (
            ("preset", [preset], Operations.presets),
            ("method", methods, Operations.methods),
        ):
            known = [resource.name for resource in await listed(self)] if names else []
            for name in names:
                if name not in known:
                    raise unknown_name(kind, name, known)

    async def _shape(self, source: ShapeLike) -> Shape:
        """The shape that a user named by a file, which is uploaded, or by a name."""
        if isinstance(source, MeshShape | BuiltInShape):
            return source
        if isinstance(source, str) and not _is_sent(source):
            return BuiltInShape(shape=source)
        return MeshShape(mesh=(await Operations.upload_mesh(self, source)).id)


def _path(*segments: str) -> str:
    """A path below /v1; an id cannot lead out of its place in it.

    Raises:
        ServiceError: One can be no id.
    """
    for segment in segments:
        if segment in ("", ".", ".."):
            raise ServiceError(
                f"{segment!r} is not an id.", "Check it; morph jobs lists those of jobs.", 404
            )
    return "".join(f"/{quote(segment, safe='')}" for segment in segments)


def _is_sent(shape: ShapeLike) -> bool:
    """Whether a shape is a file or its content, which has to be uploaded."""
    if isinstance(shape, MeshShape | BuiltInShape):
        return False
    return not isinstance(shape, str) or _is_file(shape)


def _is_file(shape: str) -> bool:
    """Whether a name is that of a file, there or not; no built-in shape has a dot or a slash."""
    if shape.startswith(TEXT_PREFIX):
        return False
    return bool({".", "/"} & set(shape)) or Path(shape).is_file()


def _validated(model: type[Model], **values: Any) -> Model:
    """A request body.

    Raises:
        ConfigError: A value is out of range.
    """
    try:
        return model(**values)
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"]))
        raise ConfigError(f"{place}: {fault['msg']}.", "Choose another value.") from None
