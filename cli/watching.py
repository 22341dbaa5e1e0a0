"""Jobs and sweeps while they last, live on standard error."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.output import print_json
from chamfer_morph.cli.progress_display import RunDisplay
from chamfer_morph.cli.tables import format_counts
from chamfer_morph.client import MorphClient
from chamfer_morph.schemas import Event, Job, JobState, Sweep

POLL_SECONDS = 1.0


def watch_job(client: MorphClient, job: Job, *, quiet: bool, as_json: bool) -> Job:
    """Show a job until it is finished; returns it as it ended."""
    with (
        _leaving_at_interrupt("job", job.id, "watch", as_json=as_json),
        RunDisplay(job.progress.frames, quiet=quiet) as display,
    ):
        _wait_for_start(client, job, display)
        for event in client.events(job.id):
            _show(event, display)
    return client.job(job.id, wait_for_service=True)


def watch_sweep(client: MorphClient, sweep: Sweep, *, quiet: bool, as_json: bool) -> Sweep:
    """Show a sweep until all of its jobs are finished; returns it as it ended."""
    with (
        _leaving_at_interrupt("sweep", sweep.id, "sweep", as_json=as_json),
        RunDisplay(len(sweep.rows), quiet=quiet) as display,
    ):
        known = {row.job: row.state for row in sweep.rows if row.state.finished}
        while len(known) < len(sweep.rows):
            time.sleep(POLL_SECONDS)
            sweep = client.sweep_status(sweep.id, wait_for_service=True)
            for row in sweep.rows:
                if row.state.finished and row.job not in known:
                    known[row.job] = row.state
                    what = f"{row.source} to {row.target}, {row.method}, seed {row.seed}"
                    display.print(f"{row.state.value}: {what} ({row.job})")
            display.describe(format_counts(sweep.counts), done=len(known))
    return sweep


def _leaving_at_interrupt(
    kind: str, name: str, command: str, *, as_json: bool
) -> AbstractContextManager[None]:
    """Within, Ctrl-C stops the watching and leaves the work to the service."""

    def report() -> None:
        if as_json:
            print_json({"id": name, "interrupted": True})
        interrupt.report(
            f"Stopped watching by Ctrl-C; the {kind} continues.",
            f"Watch it again with morph {command} {name}.",
        )

    return interrupt.at_interrupt(report)


def _wait_for_start(client: MorphClient, job: Job, display: RunDisplay) -> None:
    before: int | None = None
    while job.state is JobState.QUEUED:
        if job.queue_position != before:
            before = job.queue_position
            display.describe(f"queued, {before} before it" if before else "queued")
        time.sleep(POLL_SECONDS / 4)
        job = client.job(job.id, wait_for_service=True)
    display.describe("preparing")


def _show(event: Event, display: RunDisplay) -> None:
    data = event.data
    if event.type == "frame":
        display.advance(data["frame"], data["metrics"], data["seconds"])
    elif event.type == "stage":
        display.describe(data["stage"])
    elif event.type == "watchdog":
        placed = data["kind"] == "placement"  # which belongs to no frame
        display.print(data["message"] if placed else f"in frame {data['frame']}: {data['message']}")
    elif event.type == "attempt" and (data["attempt"] > 1 or data["resumed_frames"]):
        display.print(f"attempt {data['attempt']}, after {data['resumed_frames']} finished frames")
    elif event.type == "problem" and data["retry"]:
        display.print(f"{data['cause']} It will be tried again.")
