"""Which GPUs of this machine get a worker."""

from __future__ import annotations

import os
import subprocess

from morph_engine.errors import ConfigError, DeviceError


def chosen_gpus(text: str) -> list[str]:
    """Indices of GPUs from `all` or a list such as `0,2`.

    Raises:
        ConfigError: It is neither.
        DeviceError: There is no GPU to be found.
    """
    if text != "all":
        indices = text.split(",")
        if not all(index.isdecimal() for index in indices):
            raise ConfigError(f"--gpus {text} names no GPUs.", "Write all, or indices as in 0,2.")
        return list(dict.fromkeys(indices))
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None and all(index.isdecimal() for index in visible.split(",")):
        return visible.split(",")
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
        raise DeviceError("No NVIDIA GPU is to be found here.", "Use --slots for the CPU.")
    return listed
