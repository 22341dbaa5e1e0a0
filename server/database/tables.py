"""The service's own tables, in the database of the queue: keys, meshes, sweeps.

The state of jobs is the queue's affair and stands nowhere else.
"""

from __future__ import annotations

import time
from datetime import datetime, timezone

import sqlalchemy as sa

METADATA = sa.MetaData()

KEYS = sa.Table(
    "morph_keys",
    METADATA,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("digest", sa.String(64), nullable=False, unique=True),
    sa.Column("scopes", sa.String(64), nullable=False),
    sa.Column("created_at", sa.BigInteger, nullable=False),
)

MESHES = sa.Table(
    "morph_meshes",
    METADATA,
    sa.Column("owner", sa.String(64), primary_key=True),
    sa.Column("sha256", sa.String(64), primary_key=True),
    sa.Column("name", sa.String(255), nullable=False),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    sa.Column("created_at", sa.BigInteger, nullable=False),
    sa.Index("morph_meshes_by_age", "created_at", "sha256"),
)

SWEEPS = sa.Table(
    "morph_sweeps",
    METADATA,
    sa.Column("id", sa.String(26), primary_key=True),
    sa.Column("owner", sa.String(64), nullable=False),
    sa.Column("name", sa.String(255), nullable=False),
    sa.Column("body", sa.String(64), nullable=False),
    sa.Column("created_at", sa.BigInteger, nullable=False),
)


def create(engine: sa.Engine) -> None:
    """Create what is missing; harmless to repeat, and to do from two processes at once."""
    with engine.begin() as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(sa.text("select pg_advisory_xact_lock(7310245)"))
        for table in METADATA.sorted_tables:
            connection.execute(sa.schema.CreateTable(table, if_not_exists=True))
            for index in table.indexes:
                connection.execute(sa.schema.CreateIndex(index, if_not_exists=True))


def now() -> int:
    """The time as the tables store it, microseconds since 1970 in UTC."""
    return time.time_ns() // 1000


def as_time(microseconds: int) -> datetime:
    """A stored time."""
    return datetime.fromtimestamp(microseconds / 1e6, timezone.utc)
