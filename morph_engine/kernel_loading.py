"""Taichi is imported, and kernels that are in its offline cache are loaded, in half the time.

Taichi 1.7 translates the syntax tree of a kernel whenever a process first calls it, cached or not.
Most of that time goes to the source lines that an error at each node would show. And for each
decorator it searches all loaded modules for a line of source, which imports each of them that was
to be imported when first used. Here errors name file, line and function, and the line is read from
the file that the frame itself names. A function that many kernels call is looked up once, and its
lines are laid out once. Device arrays do not keep the text of the stack that made them.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import linecache
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any


def shorten() -> None:
    """Import Taichi, and use shorter code in it where it is as expected.

    Kernels and their cache stay the same.
    """
    with _no_search_of_modules():
        # before its modules: a lazy package is loaded twice else, and in Python 3.10 at first use
        _ = importlib.import_module("taichi").__version__
    from taichi import lang
    from taichi.lang import kernel_impl
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

    if hasattr(ASTTransformerContext, "get_pos_info"):
        ASTTransformerContext.get_pos_info = _position
    patterns = getattr(kernel_impl, "_KERNEL_CLASS_STACKFRAME_STMT_RES", None)
    looked_for = getattr(kernel_impl, "_inside_class", None)
    if patterns and looked_for and [*inspect.signature(looked_for).parameters] == [_LEVEL]:
        kernel_impl._inside_class = _inside_class
    for module in (lang._ndarray, lang.matrix):
        if hasattr(module, "get_traceback"):
            module.get_traceback = lambda stacklevel=1: ""
    for name in ("getsourcelines", "getsourcefile"):
        look_up = getattr(kernel_impl, name, None)
        if look_up and not hasattr(look_up, "cache_info"):
            setattr(kernel_impl, name, functools.cache(look_up))
    wrapping: Any = getattr(kernel_impl, "textwrap", None)
    if hasattr(wrapping, "fill") and hasattr(wrapping, "dedent"):
        kernel_impl.textwrap = SimpleNamespace(
            fill=functools.cache(wrapping.fill), dedent=functools.cache(wrapping.dedent)
        )


_LEVEL = "level_of_class_stackframe"


@contextmanager
def _no_search_of_modules() -> Iterator[None]:
    """Source lines are found by file name alone, for the decorators that run on Taichi's import."""
    getmodule = inspect.getmodule
    inspect.getmodule = lambda object, _filename=None: None
    try:
        yield
    finally:
        inspect.getmodule = getmodule


def _position(context: Any, node: Any) -> str:
    """Where a node of a kernel's syntax tree stands."""
    line = node.lineno + context.lineno_offset
    return f'File "{context.file}", line {line}, in {context.func.func.__name__}:\n'


def _inside_class(level_of_class_stackframe: int) -> bool:
    """Whether the frame so many levels up is at the beginning of a class."""
    from taichi.lang import kernel_impl

    try:
        frame = sys._getframe(level_of_class_stackframe)
    except ValueError:  # there are not so many
        return False
    statement = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    return any(each.match(statement) for each in kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES)
