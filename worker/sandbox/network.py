"""Takes the network from a process that reads what strangers have sent.

Run as a program it ends with status 0 where this system lets a process do so.
"""

from __future__ import annotations

import ctypes
import sys

NEW_USER_NAMESPACE = 0x10000000
NEW_NETWORK_NAMESPACE = 0x40000000
"""Flags of the system call `unshare`, as in <linux/sched.h>."""


def leave_network() -> bool:
    """Move this process into an empty network of its own; it must have a single thread.

    Returns:
        Whether that went: on Linux, for root, or where users may have namespaces of their own.
    """
    if sys.platform != "linux":
        return False
    unshare = ctypes.CDLL(None).unshare
    attempts = (NEW_NETWORK_NAMESPACE, NEW_USER_NAMESPACE | NEW_NETWORK_NAMESPACE)
    return any(unshare(flags) == 0 for flags in attempts)


if __name__ == "__main__":
    sys.exit(not leave_network())
