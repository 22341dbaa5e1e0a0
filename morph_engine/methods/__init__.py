"""Methods: ways to move particles towards a target, one file each, behind one protocol.

To add one, write a module with two classes: options, a subclass of `MethodOptions` that has the
method's name, settings, values under presets and cost; and a subclass of `Method` that computes. In
this folder it is found by itself; a package of your own names its module by an entry point of the
group `morph.methods`. Everything else follows: command line, presets, JSON schema and estimates.
"""

from __future__ import annotations

from morph_engine.methods.method import FrameOutcome, Method, Problem
from morph_engine.methods.options import CostRates, MethodOptions
from morph_engine.methods.registry import DEFAULT_METHOD, find, names, options_of

__all__ = [
    "DEFAULT_METHOD",
    "CostRates",
    "FrameOutcome",
    "Method",
    "MethodOptions",
    "Problem",
    "find",
    "names",
    "options_of",
]
