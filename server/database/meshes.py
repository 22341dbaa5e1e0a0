"""Which key has uploaded which mesh; the files are the storage's affair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from chamfer_morph.server.database.tables import MESHES, now


@dataclass(frozen=True)
class MeshRow:
    """An upload.

    Attributes:
        owner: Name of the key; empty without keys.
        sha256: Digest of the file.
        name: Name of the file.
        size_bytes: Its size.
        created_at: When it came [microseconds since 1970].
    """

    owner: str
    sha256: str
    name: str
    size_bytes: int
    created_at: int


class MeshStore:
    """The uploads in the database. Calls block; an `owner` of None means everybody.

    Args:
        engine: The database of the queue.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def add(self, owner: str, sha256: str, name: str, size_bytes: int) -> bool:
        """Note an upload; False if this owner has the same file already."""
        row = MeshRow(owner, sha256, name, size_bytes, now())
        try:
            with self._engine.begin() as connection:
                connection.execute(MESHES.insert().values(vars(row)))
        except IntegrityError:
            return False
        return True

    def get(self, owner: str | None, sha256: str) -> MeshRow | None:
        """An upload, or None if there is none that this owner may see."""
        query = _of(owner).where(MESHES.c.sha256 == sha256).order_by(MESHES.c.created_at).limit(1)
        return next(iter(self._rows(query)), None)

    def page(
        self, owner: str | None, *, before: tuple[int, str] | None, limit: int
    ) -> list[MeshRow]:
        """Uploads, the newest first, behind the one of a time and digest."""
        query = _of(owner)
        if before is not None:
            query = query.where(sa.tuple_(MESHES.c.created_at, MESHES.c.sha256) < before)
        order = (MESHES.c.created_at.desc(), MESHES.c.sha256.desc())
        return self._rows(query.order_by(*order).limit(limit))

    def is_sole_owner(self, owner: str, sha256: str) -> bool:
        """Whether nobody else has uploaded the file."""
        query = sa.select(MESHES.c.owner).where(MESHES.c.sha256 == sha256)
        with self._engine.connect() as connection:
            return set(connection.execute(query).scalars()) <= {owner}

    def remove(self, owner: str | None, sha256: str) -> bool:
        """Forget an upload; True if nobody has the file any more."""
        query = MESHES.delete().where(MESHES.c.sha256 == sha256)
        if owner is not None:
            query = query.where(MESHES.c.owner == owner)
        left = sa.select(sa.func.count()).where(MESHES.c.sha256 == sha256)
        with self._engine.begin() as connection:
            connection.execute(query)
            return connection.execute(left).scalar_one() == 0

    def totals(self, owner: str) -> tuple[int, int]:
        """Number and size [bytes] of an owner's uploads."""
        size = sa.func.coalesce(sa.func.sum(MESHES.c.size_bytes), 0)
        query = sa.select(sa.func.count(), size).where(MESHES.c.owner == owner)
        with self._engine.connect() as connection:
            count, total = connection.execute(query).one()
        return int(count), int(total)

    def _rows(self, query: sa.Select[tuple[object, ...]]) -> list[MeshRow]:
        with self._engine.connect() as connection:
            rows: Sequence[sa.Row[tuple[object, ...]]] = connection.execute(query).all()
        return [MeshRow(**row._mapping) for row in rows]


def _of(owner: str | None) -> sa.Select[tuple[object, ...]]:
    query = sa.select(*MESHES.c)
    return query if owner is None else query.where(MESHES.c.owner == owner)
