"""The watchdog: what it did about trials and frames that cannot be accepted.

`morph_engine.mpm.faults` says what makes them unacceptable.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Event:
    """Something worth telling that happened in a frame.

    Attributes:
        frame: 0-based frame index.
        kind: "placement" (shapes scaled to fit), "rejected" (trials refused), "restart" (frame
            begun anew with half the time step), "outside" (particles out of the domain that are
            left there), "stopped" (early stopping).
        message: One sentence, which leaves the frame to who shows it.
        data: Numbers behind the message.
    """

    frame: int
    kind: str
    message: str
    data: dict[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """The event as JSON-ready data."""
        return asdict(self)


def restarted(frame: int, dt: float, cause: str) -> Event:
    """A frame begins anew with a smaller time step dt [s]."""
    message = f"Restarted at a time step of {dt:.3g} s: {cause}."
    return Event(frame, "restart", message, {"cause": cause, "dt": dt})


def outside(frame: int, count: int) -> Event:
    """So many particles are out of the domain after a frame, and are left there."""
    are = "particle has" if count == 1 else "particles have"
    message = f"{count} {are} left the domain."
    return Event(frame, "outside", message, {"count": count})


def rejected(frame: int, count: int, cause: str) -> Event:
    """So many trial steps of a frame were refused for one cause."""
    message = f"{count} trial{'s' * (count > 1)} rejected: {cause}."
    return Event(frame, "rejected", message, {"cause": cause, "count": count})
