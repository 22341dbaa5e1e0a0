"""Errors a user can act on: each names its cause and its remedy, one sentence apiece."""

from __future__ import annotations

from collections.abc import Iterable


class MorphError(Exception):
    """Base of every error the engine raises on purpose.

    Args:
        cause: One sentence that says what is wrong.
        remedy: One sentence that says what to do about it.
    """

    def __init__(self, cause: str, remedy: str) -> None:
        super().__init__(cause, remedy)
        self.cause = cause
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.cause} {self.remedy}"


class MeshError(MorphError):
    """A mesh, point cloud or shape name cannot be used."""


class ConfigError(MorphError):
    """A configuration names an unknown field or holds a value out of range."""


class ResourceError(MorphError):
    """The request needs more memory or disk than there is."""


class ResultError(MorphError):
    """A result file or run directory is missing, damaged or of another run."""


class DiskSpaceError(ResourceError, ResultError):
    """A disk has no room for a result, or refuses to take it."""


class DamagedError(ResultError):
    """A result file or run directory cannot be read as it was written."""


class DeviceError(MorphError):
    """The requested compute device cannot be used here."""


class SimulationError(MorphError):
    """A frame could not be completed even with the smallest step."""

    @classmethod
    def after(cls, frames: int, cause: str, remedy: str) -> SimulationError:
        """What ends a morph that has so many frames; the cause is part of a sentence."""
        return cls(
            f"The morph cannot continue after {frames} frame{'s' * (frames != 1)}: {cause}.",
            f"Finished frames are kept; {remedy}.",
        )


class ExtraError(MorphError, ImportError):
    """A package that an extra of this one installs is absent."""


ERRORS: dict[str, type[MorphError]] = {
    kind.__name__: kind
    for kind in (
        MeshError, ConfigError, ResourceError, ResultError, DamagedError, DeviceError,
        SimulationError, ExtraError,
    )
}  # fmt: skip
"""Every kind by its name, for those that another process has raised."""


def unknown_name(
    kind: str,
    name: str,
    known: Iterable[str],
    *,
    list_known: bool = True,
    error: type[MorphError] = ConfigError,
) -> MorphError:
    """The error for a name that is none of the known ones; its remedy has the nearest of them.

    With `list_known` the remedy lists them all, as names of a kind such as "preset", and tells the
    nearest only if it is near.
    """
    import difflib

    known = list(known)
    nearest = difflib.get_close_matches(name.lower(), known, 1, 0.6 if list_known else 0.0)
    remedy = [f"Did you mean {match!r}?" for match in nearest]
    if list_known:
        remedy.append(f"Available {kind}s: {', '.join(known)}.")
    return error(f"There is no {kind} called {name!r}.", " ".join(remedy))
