"""Where webhooks may point: public addresses, and networks that whoever runs the service allows.

A name is resolved for each connection, all its addresses are checked, and the connection goes to
one of those: what the name points to a moment later does not matter.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable, Sequence
from typing import Any

import anyio
import httpcore
import httpx

from chamfer_morph.worker.settings import Network
from morph_engine.errors import ConfigError

NOT_PUBLIC = (ipaddress.ip_network("192.0.0.0/24"), ipaddress.ip_network("fec0::/10"))
"""What some versions of Python take for public: protocol assignments, and old site-local."""

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class HostNotFoundError(ConfigError):
    """A name cannot be resolved, for now."""


def parse_url(url: str) -> httpx.URL:
    """The address of a webhook.

    Raises:
        ConfigError: It is none.
    """
    try:
        parsed = httpx.URL(url)
        host = parsed.host
    except (httpx.InvalidURL, UnicodeError) as error:
        raise ConfigError(f"The URL cannot be read ({error}).", "Check it.") from None
    if parsed.scheme not in ("http", "https") or not host:
        raise ConfigError(
            "The URL of a webhook must begin with https:// or http:// and a host.", "Check it."
        )
    if not 0 < port_of(parsed) < 1 << 16:
        raise ConfigError(f"There is no port {parsed.port}.", "Check the URL.")
    if parsed.userinfo or parsed.fragment:
        raise ConfigError(
            "The URL of a webhook must not have a user name, password or fragment.",
            "Remove them; messages are signed.",
        )
    return parsed


def port_of(url: httpx.URL) -> int:
    """The port that a URL leads to."""
    return (443 if url.scheme == "https" else 80) if url.port is None else url.port


async def resolve(host: str, port: int, allowed: Iterable[Network]) -> list[str]:
    """The addresses of a host, all of which webhooks may reach.

    Args:
        host: A name or an address.
        port: The port, of no weight for the answer.
        allowed: Networks that are not public and may be reached all the same.

    Raises:
        ConfigError: One is not public, and in no allowed network.
        HostNotFoundError: The name cannot be resolved.
    """
    try:
        found = await anyio.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise HostNotFoundError(
            f"The host {host} was not found ({error}).", "Check the URL."
        ) from None
    addresses = [str(sockaddr[0]) for *_, sockaddr in found]
    networks = list(allowed)
    for address in addresses:
        if not _may_be_reached(ipaddress.ip_address(address), networks):
            raise ConfigError(
                f"{host} is {address}, which is not a public address.",
                "Use a public address. An administrator of the service can allow "
                "networks by MORPH_WEBHOOK_NETWORKS.",
            )
    return addresses


def _may_be_reached(address: Address, allowed: Sequence[Network]) -> bool:
    """Whether an address is public or allowed."""
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped:
            return _may_be_reached(address.ipv4_mapped, allowed)
        if address.sixtofour or address.teredo:  # tunnels to IPv4 addresses of any kind
            return False
    if any(address in network for network in allowed if network.version == address.version):
        return True
    if any(address in network for network in NOT_PUBLIC if network.version == address.version):
        return False
    return address.is_global and not address.is_multicast and not address.is_reserved


class CheckedNetwork(httpcore.AsyncNetworkBackend):
    """Connects to nothing but what webhooks may reach.

    Args:
        allowed: Networks that are not public and may be reached all the same.
    """

    def __init__(self, allowed: Sequence[Network]) -> None:
        self._allowed = allowed
        self._network = httpcore.AnyIOBackend()

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """Connect to the first address of a host that answers.

        Raises:
            ConfigError: See `resolve`.
            httpcore.ConnectError: None answers.
        """
        failure: Exception | None = None
        for address in await resolve(host, port, self._allowed):
            try:
                return await self._network.connect_tcp(
                    address, port, timeout, local_address, socket_options
                )
            except (httpcore.ConnectError, httpcore.ConnectTimeout) as error:
                failure = error
        raise failure or httpcore.ConnectError("the host has no address")

    async def connect_unix_socket(
        self,
        path: str,
        timeout: float | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """Never.

        Raises:
            httpcore.ConnectError: Always.
        """
        raise httpcore.ConnectError("webhooks cannot use sockets of this machine")

    async def sleep(self, seconds: float) -> None:
        """Wait [s]."""
        await self._network.sleep(seconds)
