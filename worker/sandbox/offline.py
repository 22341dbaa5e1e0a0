"""Runs a module in this process, which leaves the network before: `offline MODULE [ARGUMENT ...]`.

An engine reads meshes that strangers have sent, and talks to its worker alone, through pipes.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from chamfer_morph.worker.sandbox import landlock
from chamfer_morph.worker.sandbox.network import leave_network
from morph_engine import scipy_loading


def main() -> None:
    """Leave the network as far as this system lets a process do so, and run the module."""
    leave(Path("/"))
    scipy_loading.shorten()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def leave(root: Path) -> None:
    """Leave the network and TCP; this process must have a single thread.

    Where there is a driver of NVIDIA's, the process stays in the network of the machine, and only
    TCP goes. That takes the right to run programs as another user, too, by which CUDA makes the
    device that it needs where the machine has not made it yet; then the process leaves nothing.

    Args:
        root: Where the file system begins.
    """
    devices = root / "dev"
    has_driver = (root / "proc/driver/nvidia").exists() or any(devices.glob("nvidia*"))
    if not has_driver:
        leave_network()
    if not has_driver or (devices / "nvidia-uvm").exists():
        landlock.leave_tcp()


if __name__ == "__main__":
    main()
