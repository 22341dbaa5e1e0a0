"""Events: what the watchdog did, kept with the result and shown to the user."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Event:
    """Something worth telling that happened in a frame.

    Attributes:
        frame: 0-based frame index.
        kind: "rejected" (trials refused), "restart" (frame begun anew with half the time step),
            "stopped" (early stopping).
        message: One sentence.
        data: Numbers behind the message.
    """

    frame: int
    kind: str
    message: str
    data: dict[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """The event as JSON-ready data."""
        return asdict(self)
