"""The sweeps that were asked for; their jobs are in the queue."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Session

from chamfer_morph.server.database.tables import SweepRow, insert, now


class SweepStore:
    """The sweeps in the database. Calls block."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def add(self, sweep_id: str, owner: str, name: str, body: str) -> tuple[SweepRow, bool]:
        """Note a sweep; one that is there already stays. Returns it, and whether it is new."""
        row = SweepRow(sweep_id, owner, name, body, now())
        if insert(self._engine, row):
            return row, True
        return self.get(sweep_id) or row, False

    def get(self, sweep_id: str) -> SweepRow | None:
        """A sweep, or None."""
        with Session(self._engine) as session:
            return session.get(SweepRow, sweep_id)
