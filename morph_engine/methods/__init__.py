"""Methods: ways to move particles towards a target, one file each, behind one protocol.

To add one, write a module with a subclass of `Method` and name the class in `_CLASSES`.
"""

from __future__ import annotations

import difflib
from importlib import import_module

from morph_engine.errors import ConfigError
from morph_engine.methods.protocol import FrameOutcome, Method, Problem

_CLASSES = {
    "joint": "morph_engine.methods.joint:Joint",
    "physics": "morph_engine.methods.physics:Physics",
}


def names() -> tuple[str, ...]:
    """Names of all methods, the default first."""
    return tuple(_CLASSES)


def find(name: str) -> type[Method]:
    """The class of a method.

    Raises:
        ConfigError: There is no such method.
    """
    if name not in _CLASSES:
        near = difflib.get_close_matches(name, _CLASSES, 1, 0.0)[0]
        raise ConfigError(
            f"There is no method called {name!r}.",
            f"Did you mean {near!r}? Methods are {', '.join(_CLASSES)}.",
        )
    module, _, attribute = _CLASSES[name].partition(":")
    method: type[Method] = getattr(import_module(module), attribute)
    return method


__all__ = ["FrameOutcome", "Method", "Problem", "find", "names"]
