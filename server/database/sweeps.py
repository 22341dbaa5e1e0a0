"""The sweeps that were asked for; their jobs are in the queue."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from chamfer_morph.server.database.tables import SWEEPS, now


@dataclass(frozen=True)
class SweepRow:
    """A sweep.

    Attributes:
        id: Its id.
        owner: Name of the key that asked for it.
        name: The user's name for it.
        body: SHA-256 of the request.
        created_at: When [microseconds since 1970].
    """

    id: str
    owner: str
    name: str
    body: str
    created_at: int


class SweepStore:
    """The sweeps in the database. Calls block.

    Args:
        engine: The database of the queue.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def add(self, sweep_id: str, owner: str, name: str, body: str) -> SweepRow:
        """Note a sweep; one that is there already stays, and is answered."""
        row = SweepRow(sweep_id, owner, name, body, now())
        try:
            with self._engine.begin() as connection:
                connection.execute(SWEEPS.insert().values(vars(row)))
        except IntegrityError:
            found = self.get(sweep_id)
            if found is None:
                raise
            return found
        return row

    def get(self, sweep_id: str) -> SweepRow | None:
        """A sweep, or None."""
        query = sa.select(*SWEEPS.c).where(SWEEPS.c.id == sweep_id)
        with self._engine.connect() as connection:
            row = connection.execute(query).first()
        return SweepRow(**row._mapping) if row else None
