"""What is typed on the command line, as what it stands for."""

from __future__ import annotations

import re
from pathlib import Path

from morph_engine.errors import ConfigError, ResultError


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


def parse_frames(text: str | None) -> list[int] | None:
    """Frames as typed: 0,5,10-20 or -1; None, for all, where nothing or "all" is typed.

    Raises:
        ConfigError: It is something else.
    """
    if text is None or text == "all":
        return None
    frames: list[int] = []
    for part in text.split(","):
        found = re.fullmatch(r"\s*(-?\d+)(?:-(\d+))?\s*", part)
        if not found or (found[2] and not 0 <= int(found[1]) <= int(found[2])):
            raise ConfigError(
                f"{text!r} names no frames.", "Write them as in 0,5,10-20, or -1 for the last."
            )
        first = int(found[1])
        frames += range(first, int(found[2] or first) + 1)
    return frames


def parse_size(text: str) -> tuple[int, int]:
    """Width and height as typed: 960x720.

    Raises:
        ConfigError: It is something else.
    """
    found = re.fullmatch(r"(\d{2,5})x(\d{2,5})", text.lower())
    if not found:
        raise ConfigError(f"{text!r} is no size.", "Write it as in 960x720.")
    return int(found[1]), int(found[2])


def check_place(out: Path, *, force: bool, folder: bool = False) -> None:
    """Refuse to write where something is already, or where there is no folder.

    Args:
        out: Where to write.
        force: Whether what is there may be replaced.
        folder: Whether a folder that is there will do.

    Raises:
        ResultError: It cannot be written there.
    """
    if out.exists() and not force and not (folder and out.is_dir()):
        raise ResultError(
            f"{out} is there already.",
            "Choose another file with --out, or replace it with --force.",
        )
    if not out.absolute().parent.is_dir():
        raise ResultError(
            f"There is no folder {out.parent}.", "Make it, or choose another file with --out."
        )


def default_out(source: str, target: str, *, partial: bool = False) -> Path:
    """The result file of a run that names none: sphere-to-bunny.vtkhdf, where one stands."""
    ending = "-partial" if partial else ""
    return Path(f"{_plain(source)}-to-{_plain(target)}{ending}.vtkhdf")


def _plain(shape: str) -> str:
    return re.sub(r"\W+", "-", Path(shape).stem).strip("-") or "shape"
