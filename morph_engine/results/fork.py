"""A run that begins with frames of another one and goes on from there with other settings."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from morph_engine.config import MorphConfig, override
from morph_engine.errors import ConfigError
from morph_engine.results.spool import Checkpoint, Spool, SpoolReader
from morph_engine.results.trajectory import Trajectory

FIXED = ("seed", "precision", "f1_tau", "grid", "sampling", "placement")
"""Settings, or sections of them, that the particles and the numbers of all frames depend on."""


def forked_config(config: MorphConfig, overrides: Mapping[str, Any], frame: int) -> MorphConfig:
    """The configuration of a fork.

    Args:
        config: That of the original run.
        overrides: Settings by dotted path, in place of the original's.
        frame: Index of the last frame that both have in common.

    Raises:
        ConfigError: An unknown setting, a value out of range, one that a fork has to keep, or no
            frame is left to compute.
    """
    settings = dict(overrides)
    if settings.pop("method", config.method.name) != config.method.name:
        raise _fixed("method")
    changed = override(config, settings)
    before, after = config.model_dump(), changed.model_dump()
    for name in (*FIXED, *config.method.fixed):
        if _value(before, name) != _value(after, name):
            raise _fixed(name)
    if changed.frames <= frame + 1:
        raise ConfigError(
            f"After frame {frame}, none of the {changed.frames} frames is left to compute.",
            "Fork at an earlier frame, or raise `frames`.",
        )
    return changed


def begin_fork(original: str | Path, state: Checkpoint, config: MorphConfig, out: Path) -> None:
    """Make the run directory of a fork, from which `run` goes on with `resume`.

    Args:
        original: Result file of the original run, or where it is to be.
        state: The state of the original run after the last frame that both have in common.
        config: Of the fork, see `forked_config`.
        out: Result file of the fork.

    Raises:
        ResultError: The original lacks a frame or is damaged, or the disk refuses.
    """
    with ExitStack() as stack:
        run: Spool | Trajectory
        if SpoolReader(original).exists:
            run = stack.enter_context(Spool.open(original, writable=False))
            metrics = run.metrics
        else:
            run = stack.enter_context(Trajectory(original))
            metrics = run.metrics_at
        record = replace(run.run, config=config)
        spool = stack.enter_context(Spool.create(out, record, replace=True))
        for index in range(state.frame + 1):
            events = [event for event in run.events if event["frame"] == index]
            spool.append(index, run.positions(index), metrics(index), events, run.det_f(index))
        spool.save_checkpoint(state.frame, state.arrays, state.scalars)


def _value(tree: Mapping[str, Any], name: str) -> Any:
    """A setting or section that all methods share, or else an option of the method."""
    return tree[name] if name in tree else tree["method"][name]


def _fixed(name: str) -> ConfigError:
    return ConfigError(
        f"A fork cannot change {name}: the frames it starts with depend on it.",
        "Leave it unchanged, or start a new run.",
    )
