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
from chamfer_morph.worker.locks import lock_transaction
from chamfer_morph.worker.webhooks.webhooks import Webhooks
from morph_engine.errors import ConfigError

PREFIX = "morph_"


class LastAdminError(ConfigError):
    """The last key that can make others is to be revoked before these."""

    def __init__(self, name: str) -> None:
        super().__init__(
            f"{name} is the last key that can make keys.",
            "Revoke the others first, or make another with the scope admin.",
        )


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
        """Have a key of this name with this secret; harmless to repeat, and from two processes.

        Raises:
            ConfigError: Another key has this secret.
        """
        digest = secret_digest(secret)
        if insert(self._engine, KeyRow(name, digest, scope, now())):
            return
        others = sa.select(KeyRow.name).where(KeyRow.digest == digest, KeyRow.name != name)
        with self._engine.begin() as connection:
            if other := connection.execute(others).scalar():
                raise ConfigError(
                    f"The secret of the key {name!r} is that of the key {other!r} already.",
                    f"Choose another secret, or revoke {other!r}.",
                )
            changed = {"digest": digest, "scopes": scope}
            connection.execute(sa.update(KeyRow).where(KeyRow.name == name).values(changed))

    def has(self, digest: str) -> bool:
        """Whether there is a key whose secret has this digest, at this moment."""
        with self._engine.connect() as connection:
            found = connection.execute(sa.select(KeyRow.name).where(KeyRow.digest == digest))
            return found.first() is not None

    def remove(self, name: str) -> bool:
        """Revoke a key with its webhooks and share links; False if there is none of that name.

        To be repeated if it was interrupted.

        Raises:
            LastAdminError: The others could not make keys; it stays.
        """
        with self._engine.begin() as connection:
            lock_transaction(connection, "morph keys")  # two may revoke each other
            found = connection.execute(sa.delete(KeyRow).where(KeyRow.name == name)).rowcount
            others = connection.execute(sa.select(KeyRow.scopes)).scalars().all()
            if found and others and not any("admin" in scopes.split() for scopes in others):
                raise LastAdminError(name)
        Webhooks(self._engine).remove_of(name)  # who makes more finds no key
        ShareLinkStore(self._engine).remove_of(name)
        return bool(found)

    def _rows(self) -> list[KeyRow]:
        with Session(self._engine) as session:
            return [*session.scalars(sa.select(KeyRow).order_by(KeyRow.created_at))]


def _key(row: KeyRow) -> Key:
    scopes = [scope for scope in SCOPE_ORDER if scope in row.scopes.split()]
    return Key(name=row.name, scopes=scopes, created_at=as_time(row.created_at))
