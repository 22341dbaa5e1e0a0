"""Packages that extras of this one install: asked for, or loaded, where they are used."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from morph_engine.errors import ExtraError


def require(*packages: str, extra: str, purpose: str) -> None:
    """Refuse to go on without packages that an extra of this one installs; nothing is imported.

    Args:
        packages: Their names as modules.
        extra: The extra that installs them.
        purpose: What needs them, as the beginning of a sentence.

    Raises:
        ExtraError: One of them is not installed.
    """
    for package in packages:
        if find_spec(package) is None:
            raise _absent(package, extra, purpose)


def load(module: str, *, extra: str, purpose: str) -> Any:
    """Import a module that an extra of this package installs; `purpose` is what needs it.

    Raises:
        ExtraError: It is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise _absent(module.partition(".")[0], extra, purpose) from error


def _absent(package: str, extra: str, purpose: str) -> ExtraError:
    return ExtraError(
        f"{purpose} needs the Python package {package}, which is not installed.",
        f"Install it with: pip install 'chamfer-morph[{extra}]'",
    )
