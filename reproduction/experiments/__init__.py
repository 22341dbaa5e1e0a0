"""Experiments as data: the paper's tables, those past it, and those behind the defaults."""
