"""When a request is tried again, and after how long."""

from __future__ import annotations

import random
import time
from email.utils import parsedate_to_datetime

import httpx
from anyio import sleep

from chamfer_morph.client.errors import refusal, unexpected_answer, unreachable

FEW_ATTEMPTS = 5
"""For a single request: a few seconds, enough for a restart of the service."""

MANY_ATTEMPTS = 14
"""For what follows a job for hours: about a minute."""

FIRST_SECONDS, LONGEST_SECONDS = 0.2, 8.0
LONGEST_WAIT_SECONDS = 10.0
"""A service that asks for a longer wait is not waited for: the user should know at once."""

_TEMPORARY = {502, 503, 504}
_NOT_SENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)


class Attempts:
    """Counts failures in a row and waits after each, until there are too many.

    A request that is `repeatable` may reach the service twice.
    """

    def __init__(self, server: str, *, limit: int = FEW_ATTEMPTS, repeatable: bool = True) -> None:
        self._server = server
        self._limit = limit
        self._repeatable = repeatable
        self._failures = 0

    def succeeded(self) -> None:
        """Start counting anew."""
        self._failures = 0

    async def pause_after_loss(self, error: Exception) -> None:
        """Wait after a connection failed.

        Raises:
            ServiceError: It is not to be tried again.
        """
        may_repeat = self._repeatable or isinstance(error, _NOT_SENT)
        if not may_repeat or self._is_last():
            raise unreachable(self._server, error) from error
        await sleep(self._pause())

    async def pause_after_refusal(self, response: httpx.Response) -> None:
        """Wait after an answer that is no success.

        Raises:
            ServiceError: It is not to be tried again.
        """
        status = response.status_code
        if status < 400:
            raise unexpected_answer(self._server)
        may_repeat = status == 429 or (self._repeatable and status in _TEMPORARY)
        requested = retry_after(response) or 0
        if not may_repeat or requested > LONGEST_WAIT_SECONDS or self._is_last():
            raise refusal(response)
        await sleep(max(self._pause(), requested))

    def _is_last(self) -> bool:
        self._failures += 1
        return self._failures >= self._limit

    def _pause(self) -> float:
        longest = min(FIRST_SECONDS * 2.0 ** (self._failures - 1), LONGEST_SECONDS)
        return longest * random.uniform(0.5, 1)


def retry_after(response: httpx.Response) -> float | None:
    """What Retry-After asks for [s], given as seconds or as a date; None without one."""
    text = response.headers.get("retry-after", "")
    if text.isdigit():
        return float(text)
    try:
        return max(parsedate_to_datetime(text).timestamp() - time.time(), 0)
    except ValueError:
        return None
