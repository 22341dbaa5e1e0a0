"""Optional packages, loaded where they are used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from morph_engine.errors import ExtraError


def load(module: str, *, extra: str, purpose: str) -> Any:
    """Import a module that an extra of this package installs; `purpose` is what needs it.

    Raises:
        ExtraError: It is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise ExtraError(
            f"{purpose} needs the Python package {module.partition('.')[0]}, which is absent.",
            f"Install it with: pip install 'chamfer-morph[{extra}]'",
        ) from error
