"""The service's own tables in the database of the queue: keys, share links, meshes, sweeps, quotas.

The state of jobs is the queue's affair and stands nowhere else.
"""

from __future__ import annotations

import time
from datetime import datetime, timezone

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import DeclarativeBase, Mapped, MappedAsDataclass, Session, mapped_column

from chamfer_morph.worker.tables import create_missing
from chamfer_morph.worker.webhooks.webhooks import Webhooks


class Row(MappedAsDataclass, DeclarativeBase):
    """Base of rows that are objects, too."""


class KeyRow(Row):
    """A key, the digest of its secret, its scopes, and when it was made [microseconds]."""

    __tablename__ = "morph_keys"

    name: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    digest: Mapped[str] = mapped_column(sa.String(64), unique=True)
    scopes: Mapped[str] = mapped_column(sa.String(64))
    created_at: Mapped[int] = mapped_column(sa.BigInteger)


class ShareLinkRow(Row):
    """A link to a job, whose age [milliseconds] tells it from another with its id; who made it; the
    digest of its secret, and when it was made [microseconds].
    """  # noqa: D205

    __tablename__ = "morph_share_links"

    id: Mapped[str] = mapped_column(sa.String(26), primary_key=True)
    job: Mapped[str] = mapped_column(sa.String(26), index=True)
    job_created_at: Mapped[int] = mapped_column(sa.BigInteger)
    owner: Mapped[str] = mapped_column(sa.String(64))
    digest: Mapped[str] = mapped_column(sa.String(64), unique=True)
    created_at: Mapped[int] = mapped_column(sa.BigInteger)


class MeshRow(Row):
    """A file that a key has uploaded, and when it came [microseconds since 1970]."""

    __tablename__ = "morph_meshes"

    owner: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    sha256: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(255))
    size_bytes: Mapped[int] = mapped_column(sa.BigInteger)
    created_at: Mapped[int] = mapped_column(sa.BigInteger)


sa.Index("morph_meshes_by_age", MeshRow.created_at, MeshRow.sha256)


class SweepRow(Row):
    """A sweep of a key, the SHA-256 of its request, and when it came [microseconds since 1970]."""

    __tablename__ = "morph_sweeps"

    id: Mapped[str] = mapped_column(sa.String(26), primary_key=True)
    owner: Mapped[str] = mapped_column(sa.String(64))
    name: Mapped[str] = mapped_column(sa.String(255))
    body: Mapped[str] = mapped_column(sa.String(64))
    created_at: Mapped[int] = mapped_column(sa.BigInteger)


class ReservationRow(Row):
    """What a key is about to add, of which kind, and when that is forgotten [microseconds]."""

    __tablename__ = "morph_reservations"

    id: Mapped[str] = mapped_column(sa.String(32), primary_key=True)
    kind: Mapped[str] = mapped_column(sa.String(16))
    owner: Mapped[str] = mapped_column(sa.String(64))
    count: Mapped[int] = mapped_column(sa.BigInteger)
    expires_at: Mapped[int] = mapped_column(sa.BigInteger)


def create(engine: sa.Engine) -> None:
    """Create what is missing; harmless to repeat, and to do from two processes at once."""
    create_missing(engine, *Row.metadata.sorted_tables)
    Webhooks.create_tables(engine)


def insert(engine: sa.Engine, row: Row) -> bool:
    """Add a row; False if one with its primary key is there."""
    try:
        with Session(engine, expire_on_commit=False) as session, session.begin():
            session.add(row)
    except IntegrityError:
        return False
    return True


def now() -> int:
    """The time as the tables store it, microseconds since 1970 in UTC."""
    return time.time_ns() // 1000


def as_time(microseconds: int) -> datetime:
    """A stored time."""
    return datetime.fromtimestamp(microseconds / 1e6, timezone.utc)
