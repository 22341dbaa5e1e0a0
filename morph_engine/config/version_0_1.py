"""Configurations of version 0.1.0: one flat set of sections, of which each method read a part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

RENAMED = {
    "watchdog.domain_margin": "grid.margin",
    "grid.kernel": "kernel",
    "sampling.rest_volume": "rest_volume",
    "smoothing.late_frame_physics": "smoothing.late_frame",
    "chamfer.normalise": "chamfer.normalize",
    "optimizer.normalise_by": "optimizer.normalize_by",
    "optimizer.beta1": "descent.beta1",
    "optimizer.beta2": "descent.beta2",
    "points.steps_per_frame": "descent.steps_per_frame",
    "points.learning_rate": "descent.learning_rate",
    "points.epsilon": "descent.epsilon",
    "regularisers.repulsion": "regularizers.repulsion",
    "regularisers.smoothness": "regularizers.smoothness",
    "regularisers.volume": "regularizers.volume",
    "regularisers.neighbors": "regularizers.neighbors",
    "regularisers.repulsion_neighbors": "regularizers.repulsion_neighbors",
    "density.weighting": "weighting",
    "density.neighbors": "neighbors",
    "density.refresh_frames": "refresh_frames",
    "density.alpha": "alpha",
    "basis.cells": "cells",
    "basis.learning_rate": "descent.learning_rate",
    "sliced.directions": "directions",
    "entropy.blur": "blur",
    "entropy.rounds": "rounds",
    "transport.places": "destinations",
    "transport.sweeps": "sweeps",
    "transport.group": "group",
    "transport.rest": "rest",
    "transport.correction": "correction",
}
"""Paths of version 0.1.0 that have changed."""

_READ_BY = {
    "smoothing.late_frame": {"joint"},
    "smoothing.late_frame_physics": {"physics"},
    "points.learning_rate": {"dco", "dcd", "density_aware", "swd", "sinkhorn"},
    "basis.learning_rate": {"shared_basis"},
}
"""Methods that read an old path, where others have a setting under its new name."""


def renamed(path: str, method: str) -> str | None:
    """Today's path of a setting of version 0.1.0; None if unchanged, or ignored by the method."""
    return RENAMED.get(path) if method in _READ_BY.get(path, {method}) else None


def is_old(config: Mapping[str, Any]) -> bool:
    """Tell whether version 0.1.0 stored this configuration."""
    return isinstance(config.get("method"), str)


def converted(
    config: Mapping[str, Any], shared: Mapping[str, Any], options: Mapping[str, Any]
) -> dict[str, Any]:
    """The same configuration in today's form, without the settings that its method ignored.

    `shared` and `options` have by path what all methods share and what its method has.
    """
    method = config["method"]
    tree: dict[str, Any] = {"method": {"name": method}}
    for old, value in _leaves(config):
        if method not in _READ_BY.get(old, {method}):
            continue
        for path in (old, RENAMED.get(old, "")):
            if path in shared:
                _put(tree, path, value)
            elif path in options:
                _put(tree["method"], path, value)
    return tree


def _leaves(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in node.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _put(node: dict[str, Any], path: str, value: Any) -> None:
    *sections, leaf = path.split(".")
    for section in sections:
        node = node.setdefault(section, {})
    node[leaf] = value
