"""Which GPUs of this machine get a worker."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from itertools import takewhile

from morph_engine.errors import ConfigError, DeviceError


def chosen_gpus(text: str) -> list[str]:
    """GPUs as CUDA_VISIBLE_DEVICES names them, from `all` or a list such as `0,2`.

    Raises:
        ConfigError: It is neither.
        DeviceError: There is no GPU to be found, or none that this user may see.
    """
    if text != "all":
        indices = text.split(",")
        if not all(index.isdecimal() for index in indices):
            raise ConfigError(
                f"--gpus {text} is not a list of GPUs.", "Use all, or indices such as 0,2."
            )
        return list(dict.fromkeys(indices))
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        names = [name.strip() for name in visible.split(",")]
        found = [*takewhile(_names_gpu, names)]  # CUDA sees none behind one that it cannot find
        if not found:
            raise DeviceError(
                f"CUDA_VISIBLE_DEVICES is {visible!r}, which leaves no GPU.",
                "Unset it to use all GPUs, or use --slots for the CPU.",
            )
        return list(dict.fromkeys(found))
    try:
        listed = subprocess.run(
            ["nvidia-smi", "--query-gpu=index", "--format=csv,noheader"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
    except (OSError, subprocess.CalledProcessError):
        listed = []
    if not listed:
        raise DeviceError("No NVIDIA GPU was found.", "Use --slots for the CPU.")
    return listed


def slots_of(gpus: Sequence[str], first: int = 0) -> dict[int, str]:
    """The GPU of each worker slot, so that a GPU keeps its slot whichever others are chosen.

    Args:
        gpus: GPUs as `chosen_gpus` returns them.
        first: Number of the first slot; a GPU's index is added, or its place where it has none.
    """
    have_indices = all(gpu.isdecimal() for gpu in gpus)
    return {first + (int(gpu) if have_indices else place): gpu for place, gpu in enumerate(gpus)}


def _names_gpu(name: str) -> bool:
    """Whether a name is the index or the UUID of a GPU, or of a part of one."""
    return name.isdecimal() or name.startswith(("GPU-", "MIG-"))
