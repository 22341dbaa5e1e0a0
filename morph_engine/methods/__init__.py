"""Methods: ways to move particles towards a target, one file each, behind one protocol.

To add one, write a module with two classes: options, a subclass of `MethodOptions` that has the
method's name, settings, values under presets and cost; and a subclass of `Method` that computes. In
this folder it is found by itself; a package of your own names its module by an entry point of the
group `morph.methods`. Everything else follows: command line, presets, JSON schema and estimates.
"""

from __future__ import annotations

from morph_engine.config.method_options import DEFAULT_METHOD, names, options_of
from morph_engine.methods.method import FrameOutcome, Method, Problem, find

__all__ = ["DEFAULT_METHOD", "FrameOutcome", "Method", "Problem", "find", "names", "options_of"]
