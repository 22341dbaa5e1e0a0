"""What keys have been let in with and have not stored yet, for all API processes to count."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import sqlalchemy as sa

from chamfer_morph.server.database.tables import ReservationRow, now

LIFETIME_SECONDS = 3600.0
"""After this a reservation counts no more: its API was killed."""


class Reservation:
    """Room that is kept, or was refused.

    Attributes:
        there: How many there are without it, with what others have reserved.
        refused: Whether there is no room.
    """

    def __init__(self, engine: sa.Engine, there: int, left: int, *, refused: bool) -> None:
        self._engine = engine
        self.id: str = secrets.token_hex(16)
        self.there: int = there
        self.refused: bool = refused
        self._left = left

    def release_one(self) -> None:
        """One of what it is for is stored and counts by itself."""
        self._release(self._left - 1)

    def release(self) -> None:
        """All of it is stored, or not to be."""
        self._release(0)

    def _release(self, left: int) -> None:
        if self.refused or left == self._left:
            return
        self._left = left
        mine = ReservationRow.id == self.id
        change = sa.update(ReservationRow).values(count=left) if left else sa.delete(ReservationRow)
        with self._engine.begin() as connection:
            connection.execute(change.where(mine))


class Reservations:
    """The reservations in the database. Calls block."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine
        self._one_at_a_time = threading.Lock()

    @contextmanager
    def reserving(
        self, kind: str, owner: str, adding: int, limit: int, count: Callable[[], int]
    ) -> Iterator[Reservation]:
        """Reserve room for more of a kind, one request of a key after the other.

        Args:
            kind: What is counted.
            owner: Name of the key.
            adding: How many it wants to add.
            limit: How many it may have, with those reserved.
            count: Counts those it has.
        """
        reservation = self._reserve(kind, owner, adding, limit, count)
        try:
            yield reservation
        finally:
            reservation.release()

    def _reserve(
        self, kind: str, owner: str, adding: int, limit: int, count: Callable[[], int]
    ) -> Reservation:
        if not adding:
            return Reservation(self._engine, 0, 0, refused=False)
        mine = (ReservationRow.kind == kind) & (ReservationRow.owner == owner)
        reserved = sa.select(sa.func.coalesce(sa.func.sum(ReservationRow.count), 0)).where(mine)
        # who waits for the database's lock holds a connection, and the one who has it needs another
        with self._one_at_a_time, self._engine.begin() as connection:
            if connection.dialect.name == "postgresql":
                lock = sa.func.hashtextextended(f"morph {kind} {owner}", 0)
                connection.execute(sa.select(sa.func.pg_advisory_xact_lock(lock)))
            # SQLite locks at the first statement that writes
            connection.execute(sa.delete(ReservationRow).where(ReservationRow.expires_at < now()))
            # what is stored between these two counts twice, which is better than not at all
            there = int(connection.execute(reserved).scalar_one()) + count()
            reservation = Reservation(self._engine, there, adding, refused=there + adding > limit)
            if not reservation.refused:
                connection.execute(
                    sa.insert(ReservationRow).values(
                        id=reservation.id,
                        kind=kind,
                        owner=owner,
                        count=adding,
                        expires_at=now() + round(LIFETIME_SECONDS * 1e6),
                    )
                )
        return reservation
