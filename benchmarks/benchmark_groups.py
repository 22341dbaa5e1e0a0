"""The groups of rows, in the order of the table."""

from __future__ import annotations

from importlib import import_module

from benchmarks.comparison import Row

MODULES = {
    "forward": "forward",
    "adjoint": "adjoint",
    "neighbors": "neighbors",
    "frames": "frames",
    "product": "morph_command",
    "scaling": "scaling",
    "sizes": "sizes",
}


def measure(group: str, quick: bool) -> list[Row]:
    """Measure the rows of a group; each group's module has a function of this name."""
    rows: list[Row] = import_module(f"benchmarks.{MODULES[group]}").measure(quick)
    return rows
