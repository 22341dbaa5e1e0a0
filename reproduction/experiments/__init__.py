"""Experiments as data: the tables of the paper, and those that go past it."""
