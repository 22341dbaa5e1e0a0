"""The control groups that this process is in: containers, systemd and Slurm limit processes so."""

from __future__ import annotations

from pathlib import Path

ROOT = Path("/")


def groups(controller: str, root: Path = ROOT) -> list[Path]:
    """Folders of the groups whose limits this process has, its own before those around it.

    Args:
        controller: What is limited, as the kernel calls it: "memory", "cpu".
        root: Where the file system begins.

    Returns:
        Folders of version 2 and, where the system has it, of version 1. Not all of them need be
        there: a container may see its own group as the outermost one.
    """
    mount = root / "sys/fs/cgroup"
    try:
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:  # no Linux
        return []
    found = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        top = mount / controller if controllers else mount  # version 2 names none
        names = [name for name in path.split("/") if name]
        if ".." in names:  # of a group outside what this process sees
            names = []
        found += [top.joinpath(*names[:depth]) for depth in range(len(names), -1, -1)]
    return found
