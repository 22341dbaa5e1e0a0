"""Child Python processes: what they may import, their priority, and their end with the parent."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from pathlib import Path

NICENESS = 10

HARMLESS = frozenset({
    "PATH", "HOME", "USER", "LOGNAME", "SHELL", "LANG", "LANGUAGE", "TZ", "TMPDIR", "VIRTUAL_ENV",
    "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "DISPLAY", "MPLCONFIGDIR",
    "SYSTEMROOT", "WINDIR", "USERPROFILE", "LOCALAPPDATA", "TEMP", "TMP",
})  # fmt: skip
HARMLESS_PREFIXES = (
    "LC_", "XDG_", "PYTHON", "FONTCONFIG_",
    "OMP_", "KMP_", "GOMP_", "OPENBLAS_", "MKL_", "RAYON_", "MALLOC_",
    "TI_", "ENABLE_TAICHI_", "CUDA_", "NVIDIA_",
    "VK_", "EGL_", "LIBGL_", "MESA_", "__EGL_", "__GLX_",
)  # fmt: skip
"""Variables, by name and by beginning, that programs and libraries need and that hold no secret."""

_RUN_MODULE = (
    "import sys; del sys.argv[0]; sys.path[:1] == [''] and sys.path.pop(0); "
    "import runpy; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
)


def python_command(module: str, *arguments: str) -> list[str]:
    """The command line that runs a module in a new Python process, as ``python -m`` does.

    Unlike ``python -m`` it never imports from the working directory, where a user may have a
    `queue.py` or a folder called `server`. PYTHONPATH counts as ever.
    """
    if sys.version_info >= (3, 11):
        return [sys.executable, "-P", "-m", module, *arguments]
    else:  # has no such option
        return [sys.executable, "-c", _RUN_MODULE, module, *arguments]


def environment_without_secrets() -> dict[str, str]:
    """What a child that reads what strangers have sent is told of the variables of this process."""
    return {
        name: value
        for name, value in os.environ.items()
        if name in HARMLESS or name.startswith(HARMLESS_PREFIXES)
    }


def exit_with_parent(status: int) -> None:
    """End this process at once when its standard input ends, as it does when its parent dies."""

    def wait() -> None:
        while os.read(0, 1):
            pass
        os._exit(status)

    threading.Thread(target=wait, daemon=True).start()


def keep_output() -> int:
    """A descriptor for messages alone: what anybody prints from now on goes to standard error."""
    messages = os.dup(1)
    os.dup2(2, 1)
    return messages


def lower_priority() -> None:
    """Let other processes have the cores first, such as a service that has to answer.

    Where Linux groups processes by session it heeds the niceness of a group; ours is this process.
    """
    os.nice(NICENESS)
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(NICENESS), encoding="ascii")


def describe_exit(status: int) -> str:
    """How a process ended, by its `returncode`: the name of the signal, or its exit status."""
    return signal.Signals(-status).name if status < 0 else f"exit status {status}"
