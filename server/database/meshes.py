"""Which key has uploaded which mesh; the files are the storage's affair."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Session

from chamfer_morph.server.database.tables import MeshRow, insert, now


class MeshStore:
    """The uploads in the database. Calls block; an `owner` of None means everybody."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def add(self, owner: str, sha256: str, name: str, size_bytes: int) -> bool:
        """Note an upload; False if this owner has the same file already."""
        return insert(self._engine, MeshRow(owner, sha256, name, size_bytes, now()))

    def get(self, owner: str | None, sha256: str) -> MeshRow | None:
        """An upload, or None if there is none that this owner may see."""
        query = _of(owner).where(MeshRow.sha256 == sha256).order_by(MeshRow.created_at).limit(1)
        return next(iter(self._rows(query)), None)

    def page(
        self, owner: str | None, *, before: tuple[int, str] | None, limit: int
    ) -> list[MeshRow]:
        """Uploads, the newest first, behind the one of a time and digest."""
        query = _of(owner)
        if before is not None:
            query = query.where(sa.tuple_(MeshRow.created_at, MeshRow.sha256) < before)
        order = (MeshRow.created_at.desc(), MeshRow.sha256.desc())
        return self._rows(query.order_by(*order).limit(limit))

    def is_sole_owner(self, owner: str, sha256: str) -> bool:
        """Whether nobody else has uploaded the file."""
        query = sa.select(MeshRow.owner).where(MeshRow.sha256 == sha256)
        with self._engine.connect() as connection:
            return set(connection.execute(query).scalars()) <= {owner}

    def remove(self, owner: str | None, sha256: str) -> bool:
        """Forget an upload; True if nobody has the file any more."""
        query = sa.delete(MeshRow).where(MeshRow.sha256 == sha256)
        if owner is not None:
            query = query.where(MeshRow.owner == owner)
        left = sa.select(sa.func.count()).where(MeshRow.sha256 == sha256)
        with self._engine.begin() as connection:
            connection.execute(query)
            return connection.execute(left).scalar_one() == 0

    def totals(self, owner: str) -> tuple[int, int]:
        """Number and size [bytes] of an owner's uploads."""
        size = sa.func.coalesce(sa.func.sum(MeshRow.size_bytes), 0)
        query = sa.select(sa.func.count(), size).where(MeshRow.owner == owner)
        with self._engine.connect() as connection:
            count, total = connection.execute(query).one()
        return int(count), int(total)

    def _rows(self, query: sa.Select[MeshRow]) -> list[MeshRow]:
        with Session(self._engine) as session:
            return [*session.scalars(query)]


def _of(owner: str | None) -> sa.Select[MeshRow]:
    query = sa.select(MeshRow)
    return query if owner is None else query.where(MeshRow.owner == owner)
