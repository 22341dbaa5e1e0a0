"""Which code shapes a run of a method, as one SHA-256.

The code is that of the modules which the method's own module imports, directly or not, together
with those that every run needs: from shapes to frames, and from frames to metrics. So a change of
rendering, of the service or of another method leaves the digest alone. Of a module counts what its
syntax tree says, without docstrings: comments, layout and line ends do not. Other packages do not
count either; the versions of those that matter stand with every result.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import sys
from collections.abc import Iterator
from functools import cache
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

import numpy as np

from morph_engine import kept_results, methods

OF_EVERY_RUN = ("morph_engine.morphing", "morph_engine.metrics.summary")
"""Modules that run any method, and that measure what it leaves."""

SHOWING = ("morph_engine.export.", "morph_engine.rendering.")
"""Beginnings of modules that a result imports to show itself, and that shape no run."""


@cache
def code_digest(method: str) -> str:
    """SHA-256 of the code that shapes the runs of a method, in hexadecimal, on any Python the same.

    Raises:
        ConfigError: There is no such method.
    """
    return str(_code(method)["digest"])


@cache
def code_files(method: str) -> dict[str, Path]:
    """The files with that code by the names of their modules, in alphabetical order.

    They are of this package and, for a method that another package brings, of that one.

    Raises:
        ConfigError: There is no such method.
    """
    return {str(module): _holder(str(module))[1] for module in _code(method)["modules"]}


@cache
def _code(method: str) -> kept_results.Arrays:
    """The digest and the names of the modules.

    They are found once where results are kept, as all files of this package count for what is kept:
    to read them takes a tenth of the time that it takes to understand them.
    """

    def find() -> kept_results.Arrays:
        digest, files = hashlib.sha256(), _files(method)
        for module, file in files.items():
            digest.update(f"{module}: {_canonical(_tree(file))}\n".encode())
        return {"digest": np.array(digest.hexdigest()), "modules": np.array([*files])}

    own = methods.options_of(method).__module__.partition(".")[0] == __package__
    return kept_results.kept("code", (method,), find) if own else find()


def _files(method: str) -> dict[str, Path]:
    waiting = [methods.options_of(method).__module__, *OF_EVERY_RUN]
    packages = {module.partition(".")[0] for module in waiting}
    found: dict[str, Path] = {}
    while waiting:
        name = waiting.pop()
        if name.partition(".")[0] in packages:
            module, file = _holder(name)
            if module not in found and not f"{module}.".startswith(SHOWING):
                found[module] = file
                waiting += _references(module, file)
    return dict(sorted(found.items()))


def _references(module: str, file: Path) -> Iterator[str]:
    """Dotted names of what a module imports, and of what it takes from modules it has imported.

    The latter are needed because packages such as `losses` import their modules when a name of
    theirs is used, as in ``losses.Regularizers``.
    """
    names = _imported(module, file)
    yield from names.values()
    for node in ast.walk(_tree(file)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id in names:
                yield f"{names[node.value.id]}.{node.attr}"


@cache
def _imported(module: str, file: Path) -> dict[str, str]:
    """What the names that a module imports stand for: dotted names, by the name in the module."""
    package = module if file.stem == "__init__" else module.rpartition(".")[0]
    names = {}
    for node in ast.walk(_tree(file)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                names[alias.asname or alias.name] = alias.name
        elif isinstance(node, ast.ImportFrom):
            origin = resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                names[alias.asname or alias.name] = f"{origin}.{alias.name}"
    return names


def _holder(name: str) -> tuple[str, Path]:
    """The module that a dotted name is, or that has it, and its file."""
    file = _file(name)
    if file:
        return name, file
    parent, _, last = name.rpartition(".")
    module, file = _holder(parent)
    stub = file.with_suffix(".pyi")  # tells which module of a package has what
    names = _imported(module, stub) if stub.is_file() else {}
    return _holder(names[last]) if last in names else (module, file)


def _file(module: str) -> Path | None:
    """Where the source of a module lies, if there is such a module; its package is imported."""
    package, *path = module.split(".")
    top = Path(inspect.getfile(sys.modules[package]))
    if not path:
        return top
    place = top.parent.joinpath(*path)
    files = place / "__init__.py", place.with_suffix(".py")
    return next((file for file in files if file.is_file()), None)


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_bytes())


def _canonical(node: Any) -> str:
    """A syntax tree as text, without positions, docstrings and fields that are empty."""
    if isinstance(node, list):
        return f"[{', '.join(_canonical(each) for each in node if not _is_docstring(each))}]"
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = (
        f"{name}={_canonical(value)}"
        for name, value in ast.iter_fields(node)
        if value is not None and value != []
    )
    return f"{type(node).__name__}({', '.join(fields)})"


def _is_docstring(node: Any) -> bool:
    """Whether a statement is a string alone, which does nothing wherever it stands."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
