"""Whether the object store answers, for whoever cannot wait until it does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from chamfer_morph.worker.storage import StoreUnavailableError

LOOK_SECONDS = 5.0
"""How old a look is at most that is believed."""


class StoreWatch:
    """Looks at the store in a thread of its own, where somebody asks.

    Args:
        look: Asks the store; raises StoreUnavailableError.
    """

    def __init__(self, look: Callable[[], None]) -> None:
        self._look = look
        self._cause = ""
        self._looked_at = float("-inf")
        self._looking = threading.Lock()

    def cause(self) -> str:
        """Why the store could not be used at the last look; empty where it could."""
        old = time.monotonic() - self._looked_at > LOOK_SECONDS
        if old and self._looking.acquire(blocking=False):
            threading.Thread(target=self._look_now, daemon=True).start()
        return self._cause

    def _look_now(self) -> None:
        try:
            self._look()
            self._cause = ""
        except StoreUnavailableError as error:
            self._cause = error.cause
        finally:
            self._looked_at = time.monotonic()
            self._looking.release()
