"""How service commands reach the service: their common options, and the client they share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from chamfer_morph.client.client import MorphClient

ServerOption = Annotated[
    str | None,
    typer.Option(
        envvar="MORPH_SERVER", help="Address of the service; http://127.0.0.1:8000 if not given."
    ),
]
KeyOption = Annotated[
    str | None, typer.Option(envvar="MORPH_KEY", help="API key; better in MORPH_KEY.")
]


def connect(server: str | None, key: str | None) -> MorphClient:
    """A client for the service; nothing is sent yet.

    Raises:
        ServiceError: The address or the key cannot be one.
    """
    from chamfer_morph.client.client import MorphClient

    return MorphClient(server, key=key)
