"""The socket on which the API listens."""

from __future__ import annotations

import ipaddress
import socket

from chamfer_morph.worker.settings import Settings
from morph_engine.errors import ConfigError

BACKLOG = 1024


def listen(settings: Settings) -> socket.socket:
    """A listening socket.

    Raises:
        ConfigError: The address or the port cannot be had.
    """
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(
            settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # connections inherit it
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(place)
        listener.listen(BACKLOG)
    except OSError as error:
        raise ConfigError(
            f"Cannot listen on {settings.host} port {settings.port} ({error.strerror or error}).",
            "Choose another with MORPH_PORT or MORPH_HOST; MORPH_PORT=0 picks a free port.",
        ) from error
    return listener


def address(settings: Settings, listener: socket.socket) -> str:
    """Where a caller on this machine finds the API."""
    port = listener.getsockname()[1]
    host = settings.host
    try:
        if ipaddress.ip_address(host).is_unspecified:
            host = "127.0.0.1"
    except ValueError:
        pass
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
