"""What the service can do, written once over any transport."""

from __future__ import annotations

import io
import uuid
from collections.abc import AsyncGenerator, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, ValidationError

from chamfer_morph import schemas
from chamfer_morph.client.connection import COMPUTING_TIMEOUT, Call, Transport
from chamfer_morph.client.download import download
from chamfer_morph.client.errors import ServiceError, strange_answer
from chamfer_morph.client.job_events import follow
from chamfer_morph.client.retry import PATIENT, USUAL, Attempts
from chamfer_morph.schemas import (
    BuiltInShape,
    Event,
    Export,
    ExportFormat,
    ExportRequest,
    Fit,
    Job,
    JobPage,
    JobRequest,
    Key,
    KeyRequest,
    Mesh,
    MeshPage,
    MeshShape,
    NewKey,
    ParticleField,
    Resource,
    Shape,
    SurfaceFormat,
    Sweep,
    SweepRequest,
    Units,
    WorkerStatus,
)
from morph_engine.digest import file_sha256
from morph_engine.errors import ConfigError, MeshError, ResultError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Model = TypeVar("Model", bound=BaseModel)
ShapeLike = str | Path | Shape

TEXT_PREFIX = "text:"
PAGE_SIZE = 100
EXPORT_SECONDS = 0.5
"""How often to look whether an export is ready."""


class Service:
    """Every call to the service, as coroutines.

    All of them raise ServiceError when the service refuses or does not answer.

    Args:
        transport: Sends the calls.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    async def close(self) -> None:
        """Close all connections."""
        await self._transport.close()

    # meshes

    async def upload_mesh(self, path: str | Path) -> Mesh:
        """Upload a mesh file; what is there already is not sent again.

        Raises:
            MeshError: The file cannot be read.
        """
        path = Path(path)
        known = await self._find_mesh(path)
        if known is not None:
            return known
        call = Call("POST", "/meshes", {"name": path.name}, upload=path, repeatable=True)
        return self._parse(Mesh, await self._send(call))

    async def meshes(self) -> AsyncGenerator[Mesh, None]:
        """Your meshes, the newest first."""
        cursor: str | None = None
        while True:
            page = await self._get(MeshPage, "/meshes", limit=PAGE_SIZE, cursor=cursor)
            for mesh in page.items:
                yield mesh
            cursor = page.next_cursor
            if cursor is None:
                return

    async def mesh(self, mesh_id: str) -> Mesh:
        """One mesh."""
        return await self._get(Mesh, _at("meshes", mesh_id))

    async def delete_mesh(self, mesh_id: str) -> None:
        """Delete a mesh that no unfinished job uses."""
        await self._send(Call("DELETE", _at("meshes", mesh_id)))

    async def shape(self, source: ShapeLike) -> Shape:
        """What a user typed as a shape of the service; a file is uploaded.

        Args:
            source: Path of a mesh file, or the name of a built-in shape, or text:WORD.

        Raises:
            MeshError: The file cannot be read.
        """
        if isinstance(source, MeshShape | BuiltInShape):
            return source
        if isinstance(source, str) and not _is_file(source):
            return BuiltInShape(shape=source)
        return MeshShape(mesh=(await self.upload_mesh(source)).id)

    # jobs

    async def submit(
        self,
        source: ShapeLike,
        target: ShapeLike,
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
        idempotency_key: str | None = None,
    ) -> Job:
        """Have a morph computed.

        Args:
            source: Where the particles come from: a file, which is uploaded, or a built-in shape.
            target: What they are to become.
            preset: Configuration to start from.
            overrides: Settings by dotted path.
            method: Short for the override `method`.
            frames: Short for the override `frames`.
            seed: Short for the override `seed`.
            name: For your own use.
            device: Where to compute.
            priority: 1 to 1000; smaller runs earlier among your jobs.
            timeout_seconds: Stop after so long [s].
            idempotency_key: Calls with the same key make one job; if None, a new key, which
                holds for the repetitions within this call.

        Returns:
            The job, usually queued.

        Raises:
            MeshError: A file cannot be read.
        """
        body = _checked(
            JobRequest,
            source=await self.shape(source),
            target=await self.shape(target),
            preset=preset,
            overrides=dict(overrides or {}),
            method=method,
            frames=frames,
            seed=seed,
            name=name,
            device=device,
            priority=priority,
            timeout_seconds=timeout_seconds,
        )
        return self._parse(Job, await self._send(_once("/jobs", body, idempotency_key)))

    async def jobs(
        self,
        *,
        state: str | None = None,
        method: str | None = None,
        sweep: str | None = None,
        owner: str | None = None,
    ) -> AsyncGenerator[Job, None]:
        """Jobs, the newest first; page after page is fetched as you iterate."""
        cursor: str | None = None
        while True:
            page = await self._get(
                JobPage,
                "/jobs",
                state=state,
                method=method,
                sweep=sweep,
                owner=owner,
                limit=PAGE_SIZE,
                cursor=cursor,
            )
            for job in page.items:
                yield job
            cursor = page.next_cursor
            if cursor is None:
                return

    async def job(self, job_id: str, *, patient: bool = False) -> Job:
        """A job as it stands; patient, it waits about a minute for a service that is away."""
        return await self._get(Job, _at("jobs", job_id), patient=patient)

    async def cancel(self, job_id: str) -> Job:
        """Stop a job; its finished frames stay."""
        call = Call("POST", _at("jobs", job_id, "cancel"), repeatable=True)
        return self._parse(Job, await self._send(call))

    async def resume(self, job_id: str) -> Job:
        """Let a job that did not succeed go on after its last finished frame."""
        return self._parse(Job, await self._send(Call("POST", _at("jobs", job_id, "resume"))))

    async def retry(self, job_id: str) -> Job:
        """Compute a finished job again from its beginning."""
        return self._parse(Job, await self._send(Call("POST", _at("jobs", job_id, "retry"))))

    async def delete(self, job_id: str) -> None:
        """Delete a finished job and its result."""
        await self._send(Call("DELETE", _at("jobs", job_id)))

    def events(self, job_id: str, *, after: int = 0) -> AsyncGenerator[Event, None]:
        """What happens to a job until it is finished, as it happens.

        A lost connection is taken up again after the last event.

        Args:
            job_id: The job.
            after: Leave out events up to this id.
        """
        return follow(self._transport, _at("jobs", job_id, "events"), after)

    async def wait(self, job_id: str) -> Job:
        """The job once it is finished, however it ended."""
        async for _ in self.events(job_id):
            pass
        return await self.job(job_id, patient=True)

    # results

    async def download(self, job_id: str, path: str | Path) -> Path:
        """Fetch the result of a job into a file, which appears whole or not at all.

        What an interrupted download left beside the file is completed, not fetched again. The
        file replaces one that is there.

        Returns:
            The file.

        Raises:
            ResultError: What arrived is damaged.
        """
        await download(self._transport, _at("jobs", job_id, "result"), Path(path))
        return Path(path)

    async def frame(self, job_id: str, index: int = -1) -> NDArray[np.float32]:
        """Particle positions of a frame [dx], shape [particle_count, 3], float32.

        Args:
            job_id: The job, which may still run.
            index: 0-based; -1 is the last one finished.
        """
        return await self._points(_at("jobs", job_id, "frames", str(index)))

    async def source(self, job_id: str) -> NDArray[np.float32]:
        """Particle positions before the first frame [dx], shape [particle_count, 3], float32."""
        return await self._points(_at("jobs", job_id, "source"))

    async def target(self, job_id: str) -> NDArray[np.float32]:
        """Target points [dx], shape [target_count, 3], float32."""
        return await self._points(_at("jobs", job_id, "target"))

    async def field(self, job_id: str, name: str, index: int = -1) -> NDArray[np.float32]:
        """A field of a frame, a value per particle, shape [particle_count], float32.

        Args:
            job_id: The job, which may still run.
            name: Name of the field, see `fields`.
            index: Frame, 0-based; -1 is the last one finished.
        """
        import numpy as np

        path = _at("jobs", job_id, "frames", str(index), "fields", name)
        values = await self._get_bytes(path, format="f32")
        return np.frombuffer(values, "<f4").astype(np.float32)

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
            units: The coordinates of the target's file, or grid units.
        """
        path = _at("jobs", job_id, "frames", str(index), "surface")
        return await self._get_bytes(path, COMPUTING_TIMEOUT, format=format, units=units)

    async def thumbnail(self, job_id: str) -> bytes:
        """A WebP picture of the newest frame, 240 x 180 pixels."""
        return await self._get_bytes(_at("jobs", job_id, "thumbnail"))

    async def export(
        self,
        job_id: str,
        path: str | Path,
        format: str,
        *,
        frames: Iterable[int] | None = None,
        surface: bool = False,
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
            units: The coordinates of the target's file, or grid units.
            fields: Names of fields to carry along.

        Returns:
            The file.

        Raises:
            ResultError: The export has failed, or what arrived is damaged.
        """
        body = _checked(
            ExportRequest,
            format=format,
            frames=None if frames is None else list(frames),
            surface=surface,
            units=units,
            fields=list(fields),
        )
        asked = Call("POST", _at("jobs", job_id, "exports"), body=body, repeatable=True)
        made = self._parse(Export, await self._send(asked))
        while made.state == "running":
            await self._transport.sleep(EXPORT_SECONDS)
            try:
                made = await self._get(Export, _at("jobs", job_id, "exports", made.id))
            except ServiceError as error:
                if error.status != 404:
                    raise
                # a restart has ended it: the same request is the same export
                made = self._parse(Export, await self._send(asked))
        if made.problem is not None:
            raise ResultError(made.problem.cause, made.problem.remedy)
        file = _at("jobs", job_id, "exports", made.id, "file")
        await download(self._transport, file, Path(path))
        return Path(path)

    async def metrics(self, job_id: str) -> list[dict[str, float]]:
        """Metrics of every finished frame, and what each took [s]."""
        rows: list[dict[str, float]] = await self._get_json(_at("jobs", job_id, "metrics"))
        return rows

    async def config(self, job_id: str) -> dict[str, Any]:
        """The resolved configuration of a job."""
        config: dict[str, Any] = await self._get_json(_at("jobs", job_id, "config"))
        return config

    async def log(self, job_id: str) -> str:
        """What the engine wrote while it computed a job."""
        return (await self._send(Call("GET", _at("jobs", job_id, "log"), repeatable=True))).text

    # sweeps

    async def sweep(
        self,
        sources: Iterable[ShapeLike],
        targets: Iterable[ShapeLike],
        *,
        methods: Iterable[str] = ("transport",),
        seeds: Iterable[int] = (42,),
        preset: str = "fast",
        overrides: Mapping[str, Any] | None = None,
        frames: int | None = None,
        name: str = "",
        device: schemas.Device = "auto",
        priority: int = 100,
        timeout_seconds: float | None = None,
        idempotency_key: str | None = None,
    ) -> Sweep:
        """Have every combination of sources, targets, methods and seeds computed; see `submit`."""
        body = _checked(
            SweepRequest,
            sources=[await self.shape(source) for source in sources],
            targets=[await self.shape(target) for target in targets],
            methods=list(methods),
            seeds=list(seeds),
            preset=preset,
            overrides=dict(overrides or {}),
            frames=frames,
            name=name,
            device=device,
            priority=priority,
            timeout_seconds=timeout_seconds,
        )
        return self._parse(Sweep, await self._send(_once("/sweeps", body, idempotency_key)))

    async def sweep_status(self, sweep_id: str, *, patient: bool = False) -> Sweep:
        """A sweep and its table; patient, it waits about a minute for a service that is away."""
        return await self._get(Sweep, _at("sweeps", sweep_id), patient=patient)

    # what there is to choose from

    async def presets(self) -> list[Resource]:
        """The presets of the service."""
        return await self._get_list(Resource, "/presets")

    async def methods(self) -> list[Resource]:
        """The methods of the service."""
        return await self._get_list(Resource, "/methods")

    async def shapes(self) -> list[Resource]:
        """The built-in shapes of the service."""
        return await self._get_list(Resource, "/shapes")

    async def fields(self) -> list[ParticleField]:
        """What particles can be coloured by."""
        return await self._get_list(ParticleField, "/fields")

    async def export_formats(self) -> list[ExportFormat]:
        """What jobs can be exported to."""
        return await self._get_list(ExportFormat, "/exports/formats")

    async def particles(
        self, shape: ShapeLike, *, points_per_cell_edge: int = 3, fit: Fit = "auto"
    ) -> NDArray[np.float32]:
        """The particles a job would fill a shape with [dx], shape [n, 3], float32.

        Args:
            shape: A file, which is uploaded, or a built-in shape.
            points_per_cell_edge: Lattice points per grid unit and axis, 1 to 8.
            fit: As the setting `sampling.fit`; `auto` scales only what does not fit the domain.

        Raises:
            MeshError: The file cannot be read.
        """
        known = await self.shape(shape)
        place = ("meshes", known.mesh) if isinstance(known, MeshShape) else ("shapes", known.shape)
        path = _at(*place, "particles")
        return await self._points(path, points_per_cell_edge=points_per_cell_edge, fit=fit)

    # administration

    async def keys(self) -> list[Key]:
        """The API keys, without their secrets."""
        return await self._get_list(Key, "/keys")

    async def create_key(self, name: str, scopes: Iterable[str] = ("read", "submit")) -> NewKey:
        """A new API key; its secret is shown this once."""
        body = _checked(KeyRequest, name=name, scopes=list(scopes))
        return self._parse(NewKey, await self._send(Call("POST", "/keys", body=body)))

    async def delete_key(self, name: str) -> None:
        """Delete an API key; it is refused from then on."""
        await self._send(Call("DELETE", _at("keys", name)))

    async def workers(self) -> list[WorkerStatus]:
        """The worker slots."""
        return await self._get_list(WorkerStatus, "/workers")

    async def pause_worker(self, worker_id: str) -> WorkerStatus:
        """Let a worker finish its job and start no other."""
        call = Call("POST", _at("workers", worker_id, "pause"), repeatable=True)
        return self._parse(WorkerStatus, await self._send(call))

    async def unpause_worker(self, worker_id: str) -> WorkerStatus:
        """Let a paused worker start jobs again."""
        call = Call("POST", _at("workers", worker_id, "unpause"), repeatable=True)
        return self._parse(WorkerStatus, await self._send(call))

    # how calls are sent

    async def _send(self, call: Call, *, patient: bool = False) -> httpx.Response:
        limit = PATIENT if patient else USUAL
        attempts = Attempts(self._transport.server, limit=limit, repeatable=call.repeatable)
        while True:
            try:
                response = await self._transport.send(call)
                if response.is_success:
                    return response
                if response.status_code < 400:
                    raise strange_answer(self._transport.server)
                pause = attempts.pause_after_refusal(response)
            except httpx.TransportError as error:
                pause = attempts.pause_after_loss(error)
            await self._transport.sleep(pause)

    async def _get(
        self, model: type[Model], path: str, *, patient: bool = False, **query: Any
    ) -> Model:
        call = Call("GET", path, query, repeatable=True)
        return self._parse(model, await self._send(call, patient=patient))

    async def _get_bytes(
        self, path: str, timeout: httpx.Timeout | None = None, **query: Any
    ) -> bytes:
        call = Call("GET", path, query, repeatable=True, timeout=timeout)
        return (await self._send(call)).content

    async def _points(self, path: str, **query: Any) -> NDArray[np.float32]:
        import numpy as np

        file = io.BytesIO(await self._get_bytes(path, COMPUTING_TIMEOUT, format="npy", **query))
        points: NDArray[np.float32] = np.load(file, allow_pickle=False)
        return points

    async def _get_json(self, path: str) -> Any:
        response = await self._send(Call("GET", path, repeatable=True))
        try:
            return response.json()
        except ValueError:
            raise strange_answer(self._transport.server) from None

    async def _get_list(self, model: type[Model], path: str) -> list[Model]:
        try:
            return [model.model_validate(item) for item in await self._get_json(path)]
        except (ValidationError, TypeError):
            raise strange_answer(self._transport.server) from None

    def _parse(self, model: type[Model], response: httpx.Response) -> Model:
        try:
            return model.model_validate_json(response.content)
        except ValidationError:
            raise strange_answer(self._transport.server) from None

    async def _find_mesh(self, path: Path) -> Mesh | None:
        try:
            digest = file_sha256(path)
        except OSError as error:
            raise MeshError(
                f"{path} cannot be read ({error.strerror}).", "Check the path of the mesh."
            ) from error
        try:
            return await self.mesh(digest)
        except ServiceError as error:
            if error.status != 404:
                raise
            return None


def _at(*segments: str) -> str:
    """A path below /v1; an id cannot lead out of its place in it.

    Raises:
        ServiceError: One can be no id.
    """
    for segment in segments:
        if segment in ("", ".", ".."):
            raise ServiceError(f"{segment!r} is no id.", "Look it up with morph jobs.", 404)
    return "".join(f"/{quote(segment, safe='')}" for segment in segments)


def _is_file(shape: str) -> bool:
    """Whether a name is that of a file, there or not; no built-in shape has a dot or a slash."""
    if shape.startswith(TEXT_PREFIX):
        return False
    return bool({".", "/"} & set(shape)) or Path(shape).is_file()


def _once(path: str, body: BaseModel, key: str | None) -> Call:
    """A call that has one effect however often it is sent."""
    headers = {"Idempotency-Key": key or str(uuid.uuid4())}
    return Call("POST", path, body=body, headers=headers, repeatable=True)


def _checked(model: type[Model], **values: Any) -> Model:
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
