"""Operations are written once, as coroutines; one client awaits them, the other blocks."""

from __future__ import annotations

import weakref
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from contextlib import ExitStack
from functools import cached_property, wraps
from types import MethodType
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, overload

from anyio.from_thread import BlockingPortal, start_blocking_portal

from chamfer_morph.client.connection import Connection

P = ParamSpec("P")
R_co = TypeVar("R_co", covariant=True)
T = TypeVar("T")
Self = TypeVar("Self")

_END: Any = object()


class operation(Generic[P, R_co]):
    """Makes a coroutine or asynchronous generator a method of both clients."""

    def __init__(self, method: Callable[Concatenate[Any, P], R_co]) -> None:
        self._method = method
        self.__doc__ = method.__doc__

    @overload
    def __get__(
        self, client: None, owner: type | None = None
    ) -> Callable[Concatenate[Any, P], R_co]: ...
    @overload
    def __get__(self, client: AsyncExecution, owner: type | None = None) -> Callable[P, R_co]: ...
    @overload
    def __get__(
        self: operation[P, Coroutine[Any, Any, T]],
        client: BlockingExecution,
        owner: type | None = None,
    ) -> Callable[P, T]: ...
    @overload
    def __get__(
        self: operation[P, AsyncGenerator[T, None]],
        client: BlockingExecution,
        owner: type | None = None,
    ) -> Callable[P, Iterator[T]]: ...

    def __get__(
        self, client: AsyncExecution | BlockingExecution | None, owner: type | None = None
    ) -> Callable[..., Any]:
        """The method, as the class of the client runs it."""
        return self._method if client is None else client._bound(self._method)


class AsyncExecution:
    """Operations run in the event loop of the caller."""

    _connection: Connection

    async def close(self) -> None:
        """Close all connections."""
        await self._connection.close()

    async def __aenter__(self: Self) -> Self:
        return self

    async def __aexit__(self, *details: object) -> None:
        await self.close()

    def _bound(self, method: Callable[..., Any]) -> Callable[..., Any]:
        return MethodType(method, self)


class BlockingExecution:
    """Operations run to their end, in an event loop in a thread of the client's own."""

    _connection: Connection

    def close(self) -> None:
        """Close all connections."""
        self._exit_stack.close()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *details: object) -> None:
        self.close()

    @cached_property
    def _exit_stack(self) -> ExitStack:
        return ExitStack()

    @cached_property
    def _portal(self) -> BlockingPortal:
        portal = self._exit_stack.enter_context(start_blocking_portal())
        self._exit_stack.callback(portal.call, self._connection.close)
        # while threads still run: at the end of the interpreter, one that is not closed would wait
        # for its own for ever
        weakref.finalize(self, self._exit_stack.close)
        return portal

    def _bound(self, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def call(*args: Any, **kwargs: Any) -> Any:
            started = method(self, *args, **kwargs)
            if isinstance(started, AsyncGenerator):
                return self._iterate(started)
            return self._portal.call(lambda: started)

        return call

    def _iterate(self, items: AsyncGenerator[T, None]) -> Iterator[T]:
        try:
            while (item := self._portal.call(anext, items, _END)) is not _END:
                yield item
        finally:
            self._portal.call(items.aclose)
