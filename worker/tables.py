"""The service's own tables, beside those of the queue."""

from __future__ import annotations

import sqlalchemy as sa

LOCK = 7310245
"""Of Postgres, whose `create ... if not exists` fails where two do it at once."""


def create_missing(engine: sa.Engine, *tables: sa.Table) -> None:
    """Create what is missing; harmless to repeat, and to do from two processes at once."""
    with engine.begin() as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(sa.text(f"select pg_advisory_xact_lock({LOCK})"))
        for table in tables:
            connection.execute(sa.schema.CreateTable(table, if_not_exists=True))
            for index in table.indexes:
                connection.execute(sa.schema.CreateIndex(index, if_not_exists=True))
