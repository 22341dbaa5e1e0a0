"""Start the service, morph a sphere into a star through its API, and fetch the result.

    python examples/service_demo.py sphere-to-star.vtkhdf

`make demo` runs this. The service listens on a free port, keeps its data in a folder of its own,
and ends with the script; `--stay` leaves it running until Ctrl-C.
"""

from __future__ import annotations

import argparse
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from chamfer_morph.cli.tables import format_duration, print_outcome
from chamfer_morph.client import MorphClient


@contextmanager
def serving(data_dir: Path) -> Iterator[str]:
    """A service on this machine; yields its address."""
    serve = [sys.executable, "-m", "chamfer_morph", "serve"]
    command = [*serve, "--port", "0", "--data-dir", str(data_dir)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        log = threading.Thread(target=shutil.copyfileobj, args=(process.stderr, sys.stderr))
        try:
            for line in process.stderr:
                sys.stderr.write(line)
                if found := re.search(r"serves at (http\S+)", line):
                    log.start()
                    yield found[1]
                    break
            else:
                sys.exit("The service did not start.")
        finally:
            process.send_signal(signal.SIGTERM)
            if log.is_alive():
                log.join()  # what it says at its end, too


def compute(client: MorphClient, source: str, target: str, frames: int) -> str:
    """Have a morph computed and show how it goes.

    Returns:
        Id of the job.
    """
    job = client.submit(
        source, target, frames=frames, overrides={"sampling.points_per_cell_edge": 2}
    )
    print(f"Job {job.id} is submitted.")
    for event in client.events(job.id):
        if event.type == "frame":
            metrics = event.data["metrics"]
            print(
                f"frame {event.data['frame'] + 1:2} of {event.data['frames']}  "
                f"Chamfer distance {metrics['two_sided']:.3f}  {event.data['seconds']:.2f} s"
            )
        elif event.type == "state":
            print(f"The job is {event.data['state']}.")
    return job.id


def main() -> None:
    """Read the command line and do all of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, nargs="?", default=Path("sphere-to-star.vtkhdf"))
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--data-dir", type=Path, default=Path("demo-data"))
    parser.add_argument("--stay", action="store_true", help="leave the service running")
    arguments = parser.parse_args()

    with serving(arguments.data_dir) as server, MorphClient(server) as client:
        print(f"The service is at {server}, its API is described at {server}/docs.")
        job = client.job(compute(client, "sphere", "star", arguments.frames))
        print_outcome(job)
        if job.outcome is None or job.started_at is None or job.finished_at is None:
            sys.exit(1)
        client.download(job.id, arguments.out)
        seconds = (job.finished_at - job.started_at).total_seconds()
        print(f"Computed in {format_duration(seconds)}; the result is {arguments.out}.")
        if arguments.stay:
            with suppress(KeyboardInterrupt):
                signal.pause()
    print(f"See it again with: morph serve --data-dir {arguments.data_dir}")


if __name__ == "__main__":
    main()
