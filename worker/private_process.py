"""What a process of the service keeps from other users of its machine."""

from __future__ import annotations

import ctypes
import os
import sys

SET_DUMPABLE = 4
"""As in <linux/prctl.h>; a child that runs another program begins as any process does."""


def keep_private() -> None:
    """Let files that this process and its children make be for its user alone.

    On Linux no other process of the same user reads its memory and environment either, where
    secrets are: engines and other children that read what strangers have sent are such processes.
    """
    os.umask(0o077)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SET_DUMPABLE, 0, 0, 0, 0)
