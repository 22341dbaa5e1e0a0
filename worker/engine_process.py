"""An engine process: it computes one job. Its arguments are those of `main`.

Started without a job it gets ready for one. It then waits for a line of JSON on standard input with
`job_dir`, `attempt`, the `memory_bytes` that it may take, whether it is `traced` and the `request`
that the job was queued by. It writes frames, checkpoint, events and result, and tells its worker
about them in JSON lines on standard output. It computes only while it holds the lock of the job
directory, and only as long as its worker lives: with a job, the worker sends a byte a second on
standard input. At the end of the input, or after six silent seconds, the process ends at once; on
STOP it makes a result of the finished frames first.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import select
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from queue import Queue
from typing import Any

import psutil

from chamfer_morph.schemas import JobStage, Outcome, Problem
from chamfer_morph.worker import service_log
from chamfer_morph.worker.event_log import told_frames
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.heartbeat import STOP
from chamfer_morph.worker.job import LESS_MEMORY, JobSpec, problem_of
from chamfer_morph.worker.kept_states import keep_state
from chamfer_morph.worker.storage import Storage
from chamfer_morph.worker.tasks.write_partial_result import LOCK_SECONDS, write_partial_result
from morph_engine import backend, kept_results, spans
from morph_engine.child_process import keep_output, lower_priority
from morph_engine.code_digest import code_digest, code_files
from morph_engine.errors import MorphError, ResultError
from morph_engine.files import file_sha256, wait_for
from morph_engine.memory_limit import be_ended_first, is_out_of_memory, limit_memory
from morph_engine.morphing import prepare, run
from morph_engine.peak_memory import peak_memory
from morph_engine.results.provenance import provenance_by_now
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import Trajectory
from morph_engine.warm_up import extent_of, warm_up

SILENCE_SECONDS = 6.0

_messages: int = 1
"""Where the worker reads, as a file descriptor."""


def main(threads: int, kept_in: Path, likely: Mapping[str, Any], log_format: str) -> None:
    """Wait for a job, compute it or go on with it, and say how it went.

    Args:
        threads: CPU threads to compute with.
        kept_in: Folder of what engines keep for later jobs.
        likely: `method` and `extent` that the job will probably have, see `warm_up`.
        log_format: How to log, `text` or `json`.
    """
    global _messages
    _messages = keep_output()
    service_log.set_up_engine(log_format)
    lower_priority()
    be_ended_first()
    kept_results.keep_in(kept_in)
    jobs: Queue[dict[str, Any]] = Queue()
    threading.Thread(target=_watch_worker, args=(jobs,), daemon=True).start()
    gc.disable()  # what is imported and loaded stays
    is_ready = all(jobs.empty() for _ in warm_up(threads, **likely))
    gc.freeze()
    gc.enable()
    if is_ready:
        _send("ready", {"device": backend.active().device})
    job = jobs.get()
    if job["traced"]:
        spans.listen(_SpanMessages())
    job_dir = Path(job["job_dir"])
    _write_messages_to(job_dir / "log.txt")
    service_log.of_process.update(job=job_dir.name, request=job["request"])
    if "cuda" not in backend.available_devices():  # whose driver reserves more than there is
        limit_memory(job["memory_bytes"])
    storage = Storage(job_dir.parent.parent)
    lock = wait_for(job_dir / "lock", LOCK_SECONDS)  # an orphan of an earlier attempt may hold it
    try:
        spec = JobSpec.model_validate_json((job_dir / "spec.json").read_text(encoding="utf-8"))
        outcome = _compute(storage, job_dir.name, spec, job["attempt"], threads)
        _send("done", outcome.model_dump())
    except MorphError as error:
        _send("failed", problem_of(error).model_dump())
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        cause = "The engine ran out of memory; the limit is {:,.0f} MB per job."
        problem = Problem(
            cause=cause.format(job["memory_bytes"] / 1e6),
            remedy=LESS_MEMORY,
            kind="resources",
        )
        _send("failed", problem.model_dump())
    finally:
        lock.close()
    backend.end()  # so that kernels are compiled once, and not by every engine
    os._exit(0)  # all is on the disk, and the worker waits for the end


def _write_messages_to(log: Path) -> None:
    """Let what libraries write to standard error go to the log of the job."""
    with log.open("ab") as file:
        os.dup2(file.fileno(), 2)


def _compute(storage: Storage, job_id: str, spec: JobSpec, attempt: int, threads: int) -> Outcome:
    wall, cpu = time.time(), time.process_time()  # by which nothing of the job was computed
    out, log = storage.result_path(job_id), storage.events(job_id)
    record = _unfinished(out)
    resume = record is not None
    if record is None and _is_complete(out):
        return _outcome(out, cpu)
    if record is None and spec.fork:
        raise ResultError(
            "The frames that the job should start with are missing or damaged.",
            f"Fork job {spec.fork.job} again.",
        )
    earlier = log.read(limit=10**9)
    resumed = _checkpointed(out) if resume else 0
    method = (record or spec).config.method.name
    code = _code(method)
    log.append("attempt", {"attempt": attempt, "resumed_frames": resumed, "code": code})

    def enter(stage: JobStage) -> None:
        log.append("stage", {"stage": stage})

    if record is None:
        enter("filling")
        source, *targets = [storage.resolve(shape) for shape in spec.shapes]
        record = prepare(source, targets, spec.config)
    _send("started", {"extent": extent_of(record)})
    frames = run(
        record, device=spec.device, threads=threads, out=out, resume=resume, overwrite=True,
        on_stage=enter,
    )  # fmt: skip
    logged = told_frames(earlier)
    for frame in frames:
        if frame.index >= resumed or frame.index not in logged:
            for event in frame.events:
                log.append("watchdog", dict(event.document()))
            about = {"frame": frame.index, "frames": record.planned_frames, "attempt": attempt}
            if record.leg_count > 1:
                about |= {"leg": frame.leg, "legs": record.leg_count}
            log.append("frame", about | {"metrics": frame.metrics, "seconds": frame.seconds})
            _send("frame", {"frame": frame.index})
        if frame.index >= resumed - 1 and _is_kept(frame.index, spec):
            keep_state(storage, job_id, frame.index)
    codes = {code, *(event.data.get("code") for event in earlier if event.type == "attempt")}
    of_one_code = code if not spec.fork and (not resumed or len(codes) == 1) else ""
    provenance = provenance_by_now(method).model_copy(
        update={
            "code": of_one_code,
            "wall_seconds": round(time.time() - wall, 2),
            "cpu_seconds": round(time.process_time() - cpu, 2),
        }
    )
    outcome = _outcome(out, cpu)
    return outcome.model_copy(update={"provenance": provenance.model_dump(mode="json")})


def _is_kept(frame: int, spec: JobSpec) -> bool:
    """Whether the state after a frame is kept."""
    return spec.states_every > 0 and (frame + 1) % spec.states_every == 0


def _code(method: str) -> str:
    """Digest of the code that shapes the runs of a method.

    Empty if it was changed since this process began: nobody knows which of it was loaded before.
    """
    began = psutil.Process().create_time()
    if any(file.stat().st_mtime > began for file in code_files(method).values()):
        return ""
    return code_digest(method)


def _unfinished(out: Path) -> RunRecord | None:
    """What the run directory beside a result holds, if an attempt can go on from it.

    The record is the stored one, so that a newer program goes on with what an older one began.
    """
    try:
        with Spool.open(out, writable=False) as spool:
            spool.load_checkpoint()
            for frame in range(spool.frame_count):
                spool.positions(frame)
            return spool.run
    except ResultError:
        return None


def _checkpointed(out: Path) -> int:
    """Number of frames that need not be computed again."""
    with Spool.open(out, writable=False) as spool:
        checkpoint = spool.load_checkpoint()
        return checkpoint.frame + 1 if checkpoint else 0


def _is_complete(out: Path) -> bool:
    try:
        with Trajectory(out) as result:
            return result.status == "complete"
    except (MorphError, OSError):
        return False


def _outcome(out: Path, cpu_before: float) -> Outcome:
    with Trajectory(out) as result:
        frames = len(result)
        metrics = result.metrics_at(frames - 1)
        particles, targets = result.positions(0), result.target_points
    return Outcome(
        sha256=file_sha256(out),
        size_bytes=out.stat().st_size,
        frames=frames,
        metrics={name: value for name, value in metrics.items() if abs(value) < float("inf")},
        particle_count=len(particles),
        target_count=len(targets),
        cpu_seconds=time.process_time() - cpu_before,
        peak_memory_mb=peak_memory() / 1e6,
    )


class _SpanMessages:
    """Tells the worker of spans, when they begin and end [ns since 1970]."""

    def begin(self, name: str, attributes: Mapping[str, int]) -> None:
        _send("span_begins", {"name": name, "at": time.time_ns(), "attributes": attributes})

    def end(self) -> None:
        _send("span_ends", {"at": time.time_ns()})


def _watch_worker(jobs: Queue[dict[str, Any]]) -> None:
    """Take the job, and end this process when its worker asks for it, dies or falls silent."""
    line = b""
    while not line.endswith(b"\n"):
        received = os.read(0, 1)
        if not received:
            os._exit(ExitCode.ORPHANED)
        line += received
    job = json.loads(line)
    jobs.put(job)
    while True:
        ready, _, _ = select.select([0], [], [], SILENCE_SECONDS)
        received = os.read(0, 64) if ready else b""
        if STOP in received:
            with contextlib.suppress(MorphError, OSError):  # the frames stay where they are
                write_partial_result(Path(job["job_dir"]) / "result.vtkhdf")
            os._exit(ExitCode.STOPPED)
        if not received:
            os._exit(ExitCode.ORPHANED)


def _send(type: str, data: dict[str, Any]) -> None:
    os.write(_messages, json.dumps({"type": type, "data": data}).encode() + b"\n")


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), json.loads(sys.argv[3]), sys.argv[4])
