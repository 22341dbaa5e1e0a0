"""Which methods there are: those of this folder, and those that other packages name.

Other packages name modules, or classes, by entry points of the group `morph.methods`. All are
imported when somebody asks for methods; they must not import Taichi.
"""

from __future__ import annotations

import pkgutil
import warnings
from functools import cache
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from morph_engine.errors import unknown_name
from morph_engine.methods.method import Method, classes
from morph_engine.methods.options import MethodOptions, declared

ENTRY_POINTS = "morph.methods"

DEFAULT_METHOD = "flow"


def names() -> tuple[str, ...]:
    """Names of all methods, the default first."""
    _discover()
    return (DEFAULT_METHOD, *sorted(declared.keys() - {DEFAULT_METHOD}))


def options_of(name: str) -> type[MethodOptions]:
    """The options of a method.

    Raises:
        ConfigError: There is no such method.
    """
    if name not in names():
        raise unknown_name("method", name, names())
    return declared[name]


def find(name: str) -> type[Method[Any]]:
    """The class of a method.

    Raises:
        ConfigError: There is no such method.
    """
    return classes[options_of(name)]


@cache
def _discover() -> None:
    """Import every module that defines methods; one of another package that fails is left out."""
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        import_module(f"{__package__}.{module.name}")
    for entry_point in metadata.entry_points(group=ENTRY_POINTS):
        try:
            entry_point.load()
        except Exception as error:
            warnings.warn(
                f"Methods of {entry_point.value} cannot be used: {error}", RuntimeWarning, 2
            )
