"""Parsing of options: frames, sizes, lists, output files."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morph_engine.errors import ConfigError, ResultError
from morph_engine.files import morph_stem

if TYPE_CHECKING:
    from morph_engine.rendering.camera_path import CameraKey


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
                f"{text!r} is not a list of frames.",
                "Use a list such as 0,5,10-20; -1 is the last frame.",
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
        raise ConfigError(f"{text!r} is not a size.", "Use WIDTHxHEIGHT, such as 960x720.")
    return int(found[1]), int(found[2])


def parse_camera_keys(texts: Iterable[str]) -> tuple[CameraKey, ...]:
    """Places of the eye as typed, 0.5:90,30,1.5: share of the film, azimuth, elevation, zoom.

    Raises:
        ConfigError: One is something else.
    """
    from morph_engine.rendering.camera_path import CameraKey, View

    keys = []
    for text in texts:
        try:
            share, _, place = text.partition(":")
            azimuth, elevation, *zoom = (float(number) for number in place.split(","))
            keys.append(CameraKey(float(share), View(azimuth, elevation, *zoom)))
        except (TypeError, ValueError):
            raise ConfigError(
                f"{text!r} is not a camera key.",
                "Give the time as a share of the video, azimuth and elevation in degrees, and "
                "optionally a zoom: 0.5:90,30,1.5.",
            ) from None
    return tuple(keys)


def parse_settings(settings: Iterable[str]) -> dict[str, str]:
    """Settings as typed, path=value, by their paths.

    Raises:
        ConfigError: One has no equals sign.
    """
    found: dict[str, str] = {}
    for setting in settings:
        path, separator, value = setting.partition("=")
        if not separator:
            raise ConfigError(
                f"--set {setting} has no value.", "Use PATH=VALUE, as in --set chamfer.weight=5."
            )
        found[path] = value
    return found


def read_landmarks(pairs: Iterable[str], file: Path | None) -> list[dict[str, Any]] | None:
    """Pairs of points as typed, x,y,z:x,y,z, and as a JSON file holds them; None if there are none.

    Raises:
        ConfigError: They cannot be read; what they say is for the configuration to judge.
    """
    found: list[dict[str, Any]] = []
    if file:
        try:
            content = json.loads(file.read_text())
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{file} is not a file of landmarks: {error}.",
                'Use the form [{"source": [0, 1, 2], "target": [3, 4, 5]}].',
            ) from None
        found += content if isinstance(content, list) else [content]
    for pair in pairs:
        try:
            source, target = ([float(x) for x in end.split(",")] for end in pair.split(":"))
        except ValueError:
            raise ConfigError(
                f"{pair!r} is not a pair of points.", "Use the form --landmark 0,1,2:3,4,5."
            ) from None
        found.append({"source": source, "target": target})
    return found or None


def parse_list(text: str) -> list[str]:
    """The items of a list as typed: a,b,c."""
    return [item for part in text.split(",") if (item := part.strip())]


def parse_seeds(text: str) -> list[int]:
    """Seeds as typed: 1,2,3.

    Raises:
        ConfigError: They are no numbers.
    """
    try:
        return [int(item) for item in parse_list(text)]
    except ValueError:
        raise ConfigError(
            f"--seeds {text} is not a list of whole numbers.", "Use a list such as 1,2,3."
        ) from None


def check_output(out: Path, *, force: bool, folder: bool = False) -> None:
    """Refuse to write where something is already, or where there is no folder to write in.

    With `force` it may be replaced; with `folder` an empty folder will do.

    Raises:
        ResultError: It cannot be written there.
    """
    within = folder and out.is_dir()
    if not force and (any(out.iterdir()) if within else out.exists()):
        cause, kind = (" and is not empty", "folder") if within else ("", "file")
        raise ResultError(
            f"{out} already exists{cause}.",
            f"Choose another {kind} with --out, or replace it with --force.",
        )
    if not out.absolute().parent.is_dir():
        raise ResultError(
            f"There is no folder {out.parent}.", "Create it, or choose another file with --out."
        )


def default_output(*shapes: str, partial: bool = False) -> Path:
    """The result file of a run that names none: sphere-to-bunny.vtkhdf, where one stands."""
    return Path(f"{morph_stem(shapes, partial=partial)}.vtkhdf")
