"""Many runs on a server: submitted once, watched, and fetched into the same store as local ones."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from pathlib import Path

from chamfer_morph.client import MorphClient
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.reproduction.meshes import SUFFIX, MeshFolder
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.runner import Progress, ProgressCallback, known_records
from chamfer_morph.reproduction.runs.store import Record, Store, record_from_result
from chamfer_morph.schemas import Job, JobState, MeshShape
from morph_engine.errors import ResultError
from morph_engine.results.provenance import Provenance
from morph_engine.results.trajectory import Trajectory

POLL_SECONDS = 2.0


def execute_remotely(
    client: MorphClient,
    runs: Sequence[Run],
    store: Store,
    meshes: MeshFolder,
    *,
    any_code: bool = False,
    on_progress: ProgressCallback = lambda progress: None,
) -> dict[str, Record]:
    """Have the runs that are not in the store yet computed by a service.

    A repeated call meets the jobs of the first one; those that did not succeed go on. Each mesh is
    uploaded once, and progress is reported every few seconds. The service has to compute with the
    same code as is here, unless `any_code` will do. Returns the records of all runs by id, failed
    ones included.

    Raises:
        MorphError: A mesh is missing, or the service refuses or does not answer.
    """
    digests = {run.id: run.digest(meshes) for run in runs}
    known = known_records(runs, store, meshes, any_code=any_code)
    missing = [run for run in runs if run.id not in known]
    shapes = _upload(client, missing, meshes)
    progress = Progress(missing)
    jobs = {run.id: _submit(client, run, shapes, digests[run.id]) for run in missing}
    while len(progress.finished) < len(missing):
        for run in missing:
            if run.id in progress.finished:
                continue
            job = jobs[run.id] = client.job(jobs[run.id].id, wait_for_service=True)
            if job.state is JobState.QUEUED:
                continue
            if job.state.finished:
                progress.frames.pop(run.id, None)
                record = _fetch(client, job, run, digests[run.id], store, any_code=any_code)
                progress.finished[run.id] = record
            else:
                progress.frames[run.id] = job.progress.frame
            on_progress(progress)
        on_progress(progress)
        if len(progress.finished) < len(missing):
            time.sleep(POLL_SECONDS)
    return known | progress.finished


def _upload(client: MorphClient, runs: Sequence[Run], meshes: MeshFolder) -> dict[str, MeshShape]:
    """Upload the meshes of runs; shapes by name."""
    names = sorted({name for run in runs for name in run.shapes if name.endswith(SUFFIX)})
    uploaded = {name: client.upload_mesh(Path(meshes.locate(name))) for name in names}
    return {name: MeshShape(mesh=mesh.id) for name, mesh in uploaded.items()}


def _submit(client: MorphClient, run: Run, meshes: dict[str, MeshShape], digest: str) -> Job:
    source, target = (meshes.get(name, name) for name in run.shapes)
    wanted = hashlib.sha256(f"{digest} {run.code}".encode()).hexdigest()
    job = client.submit(
        source,
        target,
        preset=run.preset,
        overrides=run.settings,
        name=run.id,
        idempotency_key=f"reproduce {run.id} {wanted}",
    )
    stopped = (JobState.FAILED, JobState.CANCELLED, JobState.TIMED_OUT)
    return client.resume(job.id) if job.state in stopped else job


def _fetch(
    client: MorphClient, job: Job, run: Run, digest: str, store: Store, *, any_code: bool
) -> Record:
    """The record of a finished job; its result comes into the store."""
    if job.state is not JobState.SUCCEEDED:
        cause = job.problem.cause if job.problem else f"The job is {job.state.value}."
        return store.save_failure(run, digest, f"{cause} (job {job.id})")
    provenance = Provenance.model_validate(job.outcome.provenance if job.outcome else {})
    if not any_code and provenance.code != run.code:
        return store.save_failure(
            run, digest, f"The service computes with different code (job {job.id}); see --any-code."
        )
    path = store.result_path(run)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        client.download(job.id, path)
        with Trajectory(path) as result:
            if result.config != run.config():
                return store.save_failure(
                    run, digest, f"The service computes with different settings (job {job.id})."
                )
            record = record_from_result(run, digest, result, provenance)
    except ServiceError as error:
        if error.status is None:
            raise
        return store.save_failure(run, digest, str(error))
    except ResultError as error:
        return store.save_failure(run, digest, str(error))
    store.save(record)
    return record
