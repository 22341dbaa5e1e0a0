"""API keys: who may do what. Only a digest of each secret is stored."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Collection
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from chamfer_morph.schemas import Key, Scope
from chamfer_morph.server.database.tables import KEYS, as_time, now

PREFIX = "morph_"
SCOPE_ORDER: tuple[Scope, ...] = ("read", "submit", "admin")
"""Each scope includes those before it."""


@dataclass(frozen=True)
class Caller:
    """Whoever sends a request.

    Attributes:
        name: Name of the key, which owns what it makes; empty without keys.
        scope: The widest scope of the key.
    """

    name: str
    scope: Scope

    def has_scope(self, scope: Scope) -> bool:
        """Whether the key includes a scope."""
        return SCOPE_ORDER.index(scope) <= SCOPE_ORDER.index(self.scope)

    def can_see(self, owner: str) -> bool:
        """Whether the key may see what an owner made."""
        return self.name == owner or self.has_scope("admin")

    @property
    def owner_filter(self) -> str | None:
        """The owner whose things this key may list; None for everybody's."""
        return None if self.has_scope("admin") else self.name


class ApiKeyStore:
    """The keys in the database. Calls block."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def callers(self) -> dict[str, Caller]:
        """Every key's caller by the digest of its secret."""
        with self._engine.connect() as connection:
            rows = connection.execute(sa.select(KEYS.c.digest, KEYS.c.name, KEYS.c.scopes)).all()
        return {row.digest: Caller(row.name, _widest(row.scopes.split())) for row in rows}

    def all(self) -> list[Key]:
        """All keys, the oldest first."""
        with self._engine.connect() as connection:
            rows = connection.execute(sa.select(KEYS).order_by(KEYS.c.created_at)).all()
        return [_key(row) for row in rows]

    def add(self, name: str, scopes: Collection[Scope]) -> tuple[Key, str] | None:
        """Make a key.

        Returns:
            The key and its secret, which is shown this once; None if the name is taken.
        """
        secret = PREFIX + secrets.token_urlsafe(32)
        ordered = [scope for scope in SCOPE_ORDER if scope in scopes]
        created_at = now()
        row = {
            "name": name,
            "digest": secret_digest(secret),
            "scopes": " ".join(ordered),
            "created_at": created_at,
        }
        try:
            with self._engine.begin() as connection:
                connection.execute(KEYS.insert().values(row))
        except IntegrityError:
            return None
        return Key(name=name, scopes=ordered, created_at=as_time(created_at)), secret

    def remove(self, name: str) -> bool:
        """Revoke a key; False if there is none of that name."""
        with self._engine.begin() as connection:
            return bool(connection.execute(KEYS.delete().where(KEYS.c.name == name)).rowcount)


def secret_digest(secret: str) -> str:
    """What is stored of a secret: its SHA-256, enough for 32 random bytes."""
    return hashlib.sha256(secret.encode()).hexdigest()


def _widest(scopes: Collection[str]) -> Scope:
    return next((scope for scope in reversed(SCOPE_ORDER) if scope in scopes), "read")


def _key(row: sa.Row[tuple[object, ...]]) -> Key:
    return Key(name=row.name, scopes=row.scopes.split(), created_at=as_time(row.created_at))
