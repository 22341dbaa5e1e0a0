"""Libraries of the system that Taichi loads: where one lacks, the error names its package."""

from __future__ import annotations

import ctypes
import sys

from morph_engine.errors import DeviceError

LIBRARIES = {"libX11.so.6": "libx11-6"} if sys.platform == "linux" else {}
"""The libraries, and the Debian package of each."""


def missing_libraries() -> list[str]:
    """Those that cannot be loaded."""
    missing = []
    for library in LIBRARIES:
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(library)
    return missing


def require_libraries() -> None:
    """Check before Taichi is imported, which says less.

    Raises:
        DeviceError: One cannot be loaded.
    """
    if missing := missing_libraries():
        raise DeviceError(
            f"Taichi cannot be loaded without {', '.join(missing)}, which is missing on "
            "this system.",
            f"Install it: {installation(missing)}.",
        )


def installation(libraries: list[str]) -> str:
    """The command that installs them on Debian and its relatives."""
    return f"apt-get install {' '.join(LIBRARIES[library] for library in libraries)}"
