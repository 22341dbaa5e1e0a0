"""How often jobs of each worker slot were adopted since there is the service, in a table."""

from __future__ import annotations

import sqlalchemy as sa

from chamfer_morph.worker.tables import create_missing

_TABLE = sa.Table(
    "morph_adoptions",
    sa.MetaData(),
    sa.Column("slot", sa.String(255), primary_key=True),
    sa.Column("count", sa.BigInteger, nullable=False),
)


class Adoptions:
    """The table. Calls block.

    Args:
        engine: The database of the queue.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine
        create_missing(engine, _TABLE)

    def add(self, slot: str) -> None:
        """Count one; the caller holds the lock of the slot."""
        c = _TABLE.c
        more = sa.update(_TABLE).where(c.slot == slot).values(count=c.count + 1)
        with self._engine.begin() as connection:
            if not connection.execute(more).rowcount:
                connection.execute(sa.insert(_TABLE).values(slot=slot, count=1))

    def total(self) -> int:
        """Those of all slots."""
        query = sa.select(sa.func.coalesce(sa.func.sum(_TABLE.c.count), 0))
        with self._engine.connect() as connection:
            return int(connection.execute(query).scalar_one())
