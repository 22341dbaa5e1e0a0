"""Losses: what a morph minimises, each with its gradient."""
