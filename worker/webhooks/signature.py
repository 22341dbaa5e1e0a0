"""Secrets and signatures of messages, as Standard Webhooks 1.0 has them (standardwebhooks.com)."""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import secrets

from morph_engine.errors import ConfigError

PREFIX = "whsec_"
SHORTEST_BYTES, LONGEST_BYTES = 24, 64
NEW_BYTES = 32


def new_secret() -> str:
    """A random secret."""
    return PREFIX + base64.b64encode(secrets.token_bytes(NEW_BYTES)).decode()


def check_secret(secret: str) -> None:
    """Refuse what can be no secret.

    Raises:
        ConfigError: It is not `whsec_` and 24 to 64 bytes in base64.
    """
    try:
        length = len(_secret_bytes(secret))
    except binascii.Error:
        length = 0
    if not secret.startswith(PREFIX) or not SHORTEST_BYTES <= length <= LONGEST_BYTES:
        raise ConfigError(
            "This is not a valid webhook secret.",
            f"Give {PREFIX} and {SHORTEST_BYTES} to {LONGEST_BYTES} random bytes in "
            "base64, or omit it to have the service make one.",
        )


def sign(secret: str, message_id: str, timestamp: int, body: bytes) -> str:
    """The signature of a message.

    Args:
        secret: As `new_secret` makes it.
        message_id: The same in every attempt to deliver the message.
        timestamp: Of the attempt [s since 1970].
        body: What is sent.
    """
    signed = f"{message_id}.{timestamp}.".encode() + body
    digest = hmac.new(_secret_bytes(secret), signed, hashlib.sha256).digest()
    return f"v1,{base64.b64encode(digest).decode()}"


def _secret_bytes(secret: str) -> bytes:
    return base64.b64decode(secret.removeprefix(PREFIX), validate=True)
