"""Methods: ways to move particles towards a target, one file each, behind one protocol.

To add one, write a module with a subclass of `Method` and name the class in `_CLASSES`; a program
of your own registers its class with `register` instead.
"""

from __future__ import annotations

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from morph_engine.errors import ConfigError, unknown_name
from morph_engine.methods.protocol import FrameOutcome, Method, Problem

_CLASSES = {
    "transport": "morph_engine.methods.transport:Transport",
    "joint": "morph_engine.methods.joint:Joint",
    "physics": "morph_engine.methods.physics:Physics",
    "dco": "morph_engine.methods.dco:Dco",
    "dcd": "morph_engine.methods.dcd:Dcd",
    "density_aware": "morph_engine.methods.density_aware:DensityAware",
    "shared_basis": "morph_engine.methods.shared_basis:SharedBasis",
    "swd": "morph_engine.methods.swd:Swd",
    "sinkhorn": "morph_engine.methods.sinkhorn:Sinkhorn",
}


_registered: dict[str, type[Method]] = {}


def register(method: type[Method]) -> type[Method]:
    """Make a method of another program known in this process; also as a decorator.

    Raises:
        ConfigError: Its name is taken.
    """
    if method.name in _CLASSES or _registered.get(method.name, method) is not method:
        raise ConfigError(f"There is a method called {method.name!r}.", "Choose another name.")
    _registered[method.name] = method
    return method


def names() -> tuple[str, ...]:
    """Names of all methods, the default first."""
    return (*_CLASSES, *_registered)


def find(name: str) -> type[Method]:
    """The class of a method.

    Raises:
        ConfigError: There is no such method.
    """
    if name in _registered:
        return _registered[name]
    if name not in _CLASSES:
        raise unknown_name("method", name, names())
    module, _, attribute = _CLASSES[name].partition(":")
    method: type[Method] = getattr(import_module(module), attribute)
    return method


def describe(name: str) -> str:
    """One sentence on a method, read from its source so that Taichi need not be imported.

    Raises:
        ConfigError: There is no such method.
    """
    if name not in _CLASSES:
        return find(name).summary()
    module, _, attribute = _CLASSES[name].partition(":")
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return find(name).summary()
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name == attribute:
            return (ast.get_docstring(node) or "").partition("\n")[0]
    return ""


__all__ = ["FrameOutcome", "Method", "Problem", "describe", "find", "names", "register"]
