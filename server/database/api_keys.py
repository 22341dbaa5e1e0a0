"""API keys: who may do what. Only a digest of each secret is stored."""

from __future__ import annotations

import secrets
from collections.abc import Collection

import sqlalchemy as sa
from sqlalchemy.orm import Session

from chamfer_morph.schemas import Key, Scope
from chamfer_morph.server.database.callers import SCOPE_ORDER, Caller, secret_digest
from chamfer_morph.server.database.share_links import ShareLinkStore
from chamfer_morph.server.database.tables import KeyRow, as_time, insert, now
from chamfer_morph.worker.webhooks.webhooks import Webhooks

PREFIX = "morph_"


class ApiKeyStore:
    """The keys in the database. Calls block."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def callers(self) -> dict[str, Caller]:
        """Every key's caller by the digest of its secret."""
        keys = [(row.digest, _key(row)) for row in self._rows()]
        return {
            digest: Caller(key.name, key.scopes[-1], digest=digest)
            for digest, key in keys
            if key.scopes
        }

    def all(self) -> list[Key]:
        """All keys, the oldest first."""
        return [_key(row) for row in self._rows()]

    def add(self, name: str, scopes: Collection[Scope]) -> tuple[Key, str] | None:
        """Make a key.

        Returns:
            The key and its secret, which is shown this once; None if the name is taken.
        """
        secret = PREFIX + secrets.token_urlsafe(32)
        ordered = " ".join(scope for scope in SCOPE_ORDER if scope in scopes)
        row = KeyRow(name, secret_digest(secret), ordered, now())
        return (_key(row), secret) if insert(self._engine, row) else None

    def put(self, name: str, scope: Scope, secret: str) -> None:
        """Have a key of this name with this secret; harmless to repeat, and from two processes."""
        row = KeyRow(name, secret_digest(secret), scope, now())
        if insert(self._engine, row):
            return
        changed = {"digest": secret_digest(secret), "scopes": scope}
        with self._engine.begin() as connection:
            connection.execute(sa.update(KeyRow).where(KeyRow.name == name).values(changed))

    def remove(self, name: str) -> bool:
        """Revoke a key with its webhooks and share links; False if there is none of that name."""
        Webhooks(self._engine).remove_of(name)
        ShareLinkStore(self._engine).remove_of(name)
        with self._engine.begin() as connection:
            return bool(connection.execute(sa.delete(KeyRow).where(KeyRow.name == name)).rowcount)

    def _rows(self) -> list[KeyRow]:
        with Session(self._engine) as session:
            return [*session.scalars(sa.select(KeyRow).order_by(KeyRow.created_at))]


def _key(row: KeyRow) -> Key:
    scopes = [scope for scope in SCOPE_ORDER if scope in row.scopes.split()]
    return Key(name=row.name, scopes=scopes, created_at=as_time(row.created_at))
