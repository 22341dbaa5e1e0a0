"""Who asks for what is computed on request, and whether anybody still waits for it."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

from starlette.requests import Request

Wanted = TypeVar("Wanted", bound=Hashable)


class Askers(Generic[Wanted]):
    """The requests that wait for each thing."""

    def __init__(self) -> None:
        self._requests: dict[Wanted, list[Request]] = {}

    def add(self, wanted: Wanted, request: Request) -> None:
        """A request waits for a thing."""
        self._requests.setdefault(wanted, []).append(request)

    def forget(self, wanted: Wanted) -> None:
        """A thing is there, or will not come."""
        self._requests.pop(wanted, None)

    async def wait_for(self, wanted: Wanted) -> bool:
        """Whether anybody still does."""
        for request in self._requests.get(wanted, ()):
            # the first look may only find the end of the request itself
            if not (await request.is_disconnected() or await request.is_disconnected()):
                return True
        return False
