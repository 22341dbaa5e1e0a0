"""POT, the library of optimal transport, imported in half the time.

Its package imports sample data, which nobody asks for here, and they import SciPy's statistics.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any

LEFT_OUT = "ot.datasets"


def load() -> Any:
    """The package `ot` with its module `gromov`."""
    if "ot" not in sys.modules:
        _leave_out()
    importlib.import_module("ot.gromov")
    return sys.modules["ot"]


def _leave_out() -> None:
    """Have POT's sample data imported when somebody uses them."""
    stand_in = ModuleType(LEFT_OUT)

    def __getattr__(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if sys.modules.get(LEFT_OUT) is stand_in:
            del sys.modules[LEFT_OUT]
        return getattr(importlib.import_module(LEFT_OUT), name)

    stand_in.__getattr__ = __getattr__  # type: ignore[method-assign]
    sys.modules[LEFT_OUT] = stand_in
