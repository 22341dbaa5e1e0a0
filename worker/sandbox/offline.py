"""Runs a module that reads what strangers have sent: `offline FILES MODULE [ARGUMENT ...]`.

It leaves the network before, and of the files all but those of the program, a folder for temporary
ones, and FILES: JSON with the lists `reads` and `writes`. An engine talks to its worker alone,
through pipes.
"""

from __future__ import annotations

import json
import runpy
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from chamfer_morph.worker.sandbox import landlock
from chamfer_morph.worker.sandbox.network import leave_network


def main() -> None:
    """Leave network and files as far as this system lets a process do so, and run the module."""
    files = json.loads(sys.argv[1])
    leave(Path("/"), map(Path, files["reads"]), map(Path, files["writes"]))
    del sys.argv[:2]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def leave(root: Path, reads: Iterable[Path] = (), writes: Iterable[Path] = ()) -> None:
    """Leave the network, TCP and files; this process must have a single thread.

    Where there is a driver of NVIDIA's, the process stays in the network of the machine and keeps
    its files, and only TCP goes. That takes the right to run programs as another user, too, by
    which CUDA makes the device that it needs where the machine has not made it yet; then the
    process leaves nothing.

    Args:
        root: Where the file system begins.
        reads: Files and folders that it goes on reading.
        writes: Folders, made where missing, in which it goes on changing everything.
    """
    devices = root / "dev"
    if not (root / "proc/driver/nvidia").exists() and not any(devices.glob("nvidia*")):
        leave_network()
        kept = [Path(tempfile.gettempdir()), *writes]
        for folder in kept:
            with suppress(OSError):  # it cannot be written anyway
                folder.mkdir(parents=True, exist_ok=True)
        landlock.confine(reads, kept)
    elif (devices / "nvidia-uvm").exists():
        landlock.leave_tcp()


if __name__ == "__main__":
    main()
