"""Takes files and connections from a process that reads what strangers have sent, by Landlock.

Landlock is a part of Linux, from 5.13 on, by which any process may give up rights for good, for
itself and its children. Files are known to version 1, moves between folders to 2, truncation to 3,
TCP to 4, abstract sockets and signals to 6.

Run as a program it ends with status 0 where this system has it.
"""

from __future__ import annotations

import ctypes
import os
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
"""Numbers of the system calls, on every architecture the same."""

ASK_FOR_VERSION = 1
PATH_BENEATH = 1
NO_NEW_PRIVILEGES = 38
"""As in <linux/landlock.h> and <linux/prctl.h>."""

EXECUTE, WRITE_FILE, READ_FILE, READ_FOLDER = 1 << 0, 1 << 1, 1 << 2, 1 << 3
MOVE_BETWEEN_FOLDERS, TRUNCATE = 1 << 13, 1 << 14
READING = EXECUTE | READ_FILE | READ_FOLDER
OF_VERSION_1 = (1 << 13) - 1
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE
"""Rights that a file has which is no folder."""

BIND_TCP, CONNECT_TCP = 1 << 0, 1 << 1
ABSTRACT_SOCKETS, SIGNALS = 1 << 0, 1 << 1

SYSTEM = (
    "/usr", "/lib", "/lib64", "/bin", "/sbin", "/nix/store", "/sys/devices", "/sys/fs",
    *(f"/proc/{name}" for name in ("self", "cpuinfo", "filesystems", "meminfo", "stat", "sys")),
    *(f"/etc/{name}" for name in (
        "alternatives", "fonts", "group", "ld.so.cache", "localtime", "mime.types", "nsswitch.conf",
        "os-release", "passwd", "timezone",
    )),
)  # fmt: skip
"""What programs read of the system. Other processes in /proc would show their environment."""

DEVICES = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")

PRIORITIES = ("/proc/self/autogroup", "/proc/self/oom_score_adj")


class _Ruleset(ctypes.Structure):
    _fields_ = (
        ("files", ctypes.c_uint64),
        ("network", ctypes.c_uint64),  # from version 4
        ("scoped", ctypes.c_uint64),  # from version 6
    )


class _PathBeneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("allowed", ctypes.c_uint64), ("folder", ctypes.c_int32))


def version() -> int:
    """The version of Landlock that this system has; 0 for none."""
    if sys.platform != "linux":
        return 0
    known: int = _library().syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ASK_FOR_VERSION)
    return max(known, 0)


def confine(reads: Iterable[Path], writes: Iterable[Path]) -> bool:
    """Leave this process a few files, those of the program itself, and no TCP connection.

    It must have a single thread. What is open stays open.

    Args:
        reads: Files and folders that it may read; those that are not there do not count.
        writes: Files and folders that it may also change.

    Returns:
        Whether this system has Landlock.
    """
    known = version()
    if not known:
        return False
    handled = OF_VERSION_1 | (MOVE_BETWEEN_FOLDERS if known >= 2 else 0)
    handled |= TRUNCATE if known >= 3 else 0
    ruleset = _create(known, files=handled, scoped=ABSTRACT_SOCKETS | SIGNALS)
    for path in (*_program(), *reads):
        _allow(ruleset, path, READING)
    for path in (*map(Path, (*DEVICES, *PRIORITIES)), *writes):
        _allow(ruleset, path, handled & ~EXECUTE)
    _restrict(ruleset)
    return True


def leave_tcp() -> bool:
    """Leave this process no TCP connection, and everything else; it must have a single thread.

    Returns:
        Whether this system can take it.
    """
    known = version()
    if known < 4:
        return False
    _restrict(_create(known))
    return True


def _program() -> list[Path]:
    """What this program is made of: Python, packages, libraries of the system, fonts."""
    home = Path(os.environ.get("HOME", "/"))
    libraries = os.environ.get("LD_LIBRARY_PATH", "").split(":")
    fonts = [home / ".fonts", home / ".local/share/fonts"]
    python = [sys.base_prefix, sys.base_exec_prefix, *sysconfig.get_paths().values(), *sys.path]
    return [*map(Path, SYSTEM), *(Path(path) for path in (*libraries, *python) if path), *fonts]


def user_cache() -> Path:
    """The folder of what programs of this user keep and may lose."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path(os.environ.get("HOME", "/")) / ".cache")


def list_of_fonts() -> Path:
    """The folder where Matplotlib keeps which fonts there are, which takes seconds to find out."""
    return Path(os.environ.get("MPLCONFIGDIR") or user_cache() / "matplotlib")


def _create(known: int, *, files: int = 0, scoped: int = 0) -> int:
    """The descriptor of a set of rules, none of which allows anything yet."""
    rules = _Ruleset(files, BIND_TCP | CONNECT_TCP if known >= 4 else 0, 0)
    if known >= 6:
        rules.scoped = scoped
    size = 24 if known >= 6 else 16 if known >= 4 else 8
    return _call(CREATE_RULESET, ctypes.byref(rules), ctypes.c_size_t(size), 0)


def _allow(ruleset: int, path: Path, rights: int) -> None:
    try:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:  # it is not there
        return
    try:
        if not path.is_dir():
            rights &= OF_FILES
        rule = _PathBeneath(rights, descriptor)
        _call(ADD_RULE, ruleset, PATH_BENEATH, ctypes.byref(rule), 0)
    finally:
        os.close(descriptor)


def _restrict(ruleset: int) -> None:
    """Let the rules hold from now on."""
    _library().prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    _call(RESTRICT_SELF, ruleset, 0)
    os.close(ruleset)


def _call(number: int, *arguments: object) -> int:
    """What a system call returns.

    Raises:
        OSError: It has failed.
    """
    result: int = _library().syscall(number, *arguments)
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return result


def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


if __name__ == "__main__":
    sys.exit(not version())
