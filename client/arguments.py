"""What is typed on the command line, as what it stands for."""

from __future__ import annotations

import re
from pathlib import Path

from morph_engine.errors import ConfigError


def parse_overrides(settings: list[str]) -> dict[str, str]:
    """Split `path=value` as typed after --set.

    Raises:
        ConfigError: One has no equals sign.
    """
    for setting in settings:
        if "=" not in setting:
            raise ConfigError(
                f"--set {setting} names no value.", "Write it as in --set chamfer.weight=5."
            )
    return dict(setting.split("=", 1) for setting in settings)


def default_out(source: str, target: str, *, partial: bool = False) -> Path:
    """The result file of a run that names none: sphere-to-bunny.vtkhdf, where one stands."""
    ending = "-partial" if partial else ""
    return Path(f"{_plain(source)}-to-{_plain(target)}{ending}.vtkhdf")


def _plain(shape: str) -> str:
    return re.sub(r"\W+", "-", Path(shape).stem).strip("-") or "shape"
