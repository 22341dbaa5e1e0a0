"""Results of costly functions, kept on this machine for runs to come, by the digest of all inputs.

A kept result equals the computed one to the last bit: the digest counts the code of the engine, the
versions of the libraries, the processor, and every input. Nothing is kept until `keep_in` says
where, so that whoever uses the library decides. Files that cannot be written or read only cost the
time to compute again.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morph_engine.files import UNREADABLE

Arrays = dict[str, NDArray[Any]]

MOST_BYTES = 1 << 30
"""What all of them may fill; those used longest ago go first [bytes]."""

_folder: Path | None = None


def keep_in(folder: Path | None) -> None:
    """Keep results in a folder, made where missing; None: no longer."""
    global _folder
    _folder = folder


def user_folder() -> Path | None:
    """Where the commands of a user keep them; None for a user without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "chamfer-morph"
    except RuntimeError:
        return None


def kept(name: str, inputs: tuple[Any, ...], compute: Callable[[], Arrays]) -> Arrays:
    """Arrays that a function computes of some inputs, or has computed before.

    Args:
        name: Of the function.
        inputs: All that the arrays depend on: arrays, and what `repr` shows whole.
        compute: Makes the arrays; what it raises is raised, and nothing is kept.
    """
    if _folder is None:
        return compute()
    path = _folder / f"{name}-{_digest(inputs)}.npz"
    with suppress(OSError, *UNREADABLE):
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = dict(stored)
        os.utime(path)
        return arrays
    arrays = compute()
    with suppress(OSError):
        _write(path, arrays)
    return arrays


def _digest(inputs: tuple[Any, ...]) -> str:
    digest = hashlib.sha256(_engine().encode())
    for value in inputs:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype.str} {value.shape} ".encode())
            digest.update(np.ascontiguousarray(value).data)
        else:
            digest.update(f"{value!r} ".encode())
    return digest.hexdigest()


@cache
def _engine() -> str:
    """All that results depend on beside their inputs: code, libraries and processor."""
    from morph_engine.results.provenance import cpu_name
    from morph_engine.results.run_record import software_versions

    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    return f"{digest.hexdigest()} {software_versions()} {cpu_name()} "


def _write(path: Path, arrays: Arrays) -> None:
    """Write a file that appears as a whole, and delete what is too much.

    Two processes may write the same one at a time, hence the temporary names.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
        temporary = Path(file.name)
        try:
            np.savez(file, allow_pickle=False, **arrays)
            file.close()
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    _forget(path.parent)


def _forget(folder: Path) -> None:
    """Delete the files that were used longest ago, beyond the size that all may have."""
    files = [(entry.stat(), entry.path) for entry in os.scandir(folder) if entry.is_file()]
    total = 0
    for status, name in sorted(files, key=lambda file: file[0].st_mtime, reverse=True):
        total += status.st_size
        if total > MOST_BYTES:
            Path(name).unlink(missing_ok=True)
