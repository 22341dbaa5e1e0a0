"""Colours of the particles of a job, also while it runs."""

from __future__ import annotations

from functools import partial

from fastapi import Request

from chamfer_morph.server.context import ServerContext
from chamfer_morph.server.single_flight import Key
from chamfer_morph.worker.frame_reader import Colors, read_colors, read_frame
from chamfer_morph.worker.job_record import JobRecord
from morph_engine.results.run_record import RunRecord


async def find_colors(
    job: JobRecord, run: RunRecord, request: Request, context: ServerContext
) -> Colors | None:
    """Colours of the particles of a job; None where no shape has any.

    Those of a job that runs are looked up by a child process, anew when a leg begins and whenever
    the number of frames has doubled: the shape to come hardly shows before.

    Raises:
        MorphError: A frame is damaged, or it takes too much memory or time.
        ProblemError: 503, the service stops; 404, the job is deleted meanwhile.
    """
    if not run.colored:
        return None
    if stored := await context.compute(read_colors, context.storage.result_path(job.id)):
        return stored
    key = await context.compute(_key, job, context)
    return await context.colors.get(
        key, partial(context.sandbox.look_up_colors, job.id), request, job.owner
    )


def _key(job: JobRecord, context: ServerContext) -> Key:
    """Under which the colours of a job are remembered: until its frames have doubled."""
    newest = read_frame(context.storage.result_path(job.id), -1)
    return (job.id, newest.leg, (newest.index + 1).bit_length()) if newest else (job.id,)
