"""/v1/jobs/{id}/playback: which frame a player shows when."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

from chamfer_morph.schemas import Easing, Playback, Repeat
from chamfer_morph.server.auth import AuthenticatedRoute
from chamfer_morph.server.context import Context
from chamfer_morph.server.routes.job_lookup import VisibleJob, find_result
from morph_engine.results.timeline import FRAMES_PER_SECOND, Timing

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}", tags=["results"], route_class=AuthenticatedRoute
)

Rate = Annotated[float, Query(ge=1, le=120, description="Frames per second.")]


@router.get("/playback", operation_id="getPlayback", summary="Frame to show at each time")
async def get_playback(
    job: VisibleJob,
    request: Request,
    context: Context,
    seconds: Annotated[
        float | None,
        Query(
            gt=0,
            le=3600,
            description="Duration [s]; default: frames divided by `fps`, plus the pauses.",
        ),
    ] = None,
    fps: Rate = FRAMES_PER_SECOND,
    hold: Annotated[float, Query(ge=0, le=600, description="Pause at each shape [s].")] = 0.0,
    easing: Annotated[Easing, Query(description="Pace between two shapes.")] = "in-out",
    repeat: Annotated[
        Repeat,
        Query(
            description="`none`: play once; `loop`: end as it begins; `ping-pong`: play forward, "
            "then backward."
        ),
    ] = "none",
) -> Playback:
    """The frame to show at each instant, or the position between two frames.

    Time is proportional to the mean distance that particles move. Exports have the same
    `seconds`, `hold`, `easing` and `repeat`.
    """
    timing = Timing(seconds, fps, hold, easing, repeat)
    path = await find_result(job, request, context)
    return Playback.model_validate(await context.compute(_table, path, timing))


def _table(path: Path, timing: Timing) -> dict[str, Any]:
    from morph_engine.results.playback import picture_table
    from morph_engine.results.trajectory import Trajectory

    with Trajectory(path) as trajectory:
        return picture_table(trajectory, timing)
