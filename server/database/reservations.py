"""What keys have been let in with and have not stored yet, for all API processes to count."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import sqlalchemy as sa

from chamfer_morph.server.database.tables import ReservationRow, now
from chamfer_morph.worker.locks import lock_transaction

LIFETIME_SECONDS = 3600.0
"""After this a reservation counts no more, unless it was renewed: its API was killed."""


class Reservation:
    """Room that is kept, or was refused. Calls block.

    Args:
        engine: The database.
        one_at_a_time: Held while room is counted.
        kind: What is counted.
        owner: Name of the key.
        adding: How many it wants to add.
        limit: How many it may have, with those reserved.
        count: Counts those it has.

    Attributes:
        there: How many there are without it, with what others have reserved.
        refused: Whether there is no room.
    """

    def __init__(
        self,
        engine: sa.Engine,
        one_at_a_time: threading.Lock,
        kind: str,
        owner: str,
        adding: int,
        limit: int,
        count: Callable[[], int],
    ) -> None:
        self._engine = engine
        self._one_at_a_time = one_at_a_time
        self._id = secrets.token_hex(16)
        self._kind = kind
        self._owner = owner
        self._left = adding
        self._limit = limit
        self._count = count
        self.there: int = 0
        self.refused: bool = False
        self.renew()

    def renew(self) -> None:
        """Keep the room for a lifetime from now; where it has expired, others may have taken it."""
        if not self._left or self.refused:
            return
        row = ReservationRow
        same = (row.kind == self._kind) & (row.owner == self._owner)
        reserved = sa.select(sa.func.coalesce(sa.func.sum(row.count), 0)).where(same)
        expires_at = now() + round(LIFETIME_SECONDS * 1e6)
        # who waits for the database's lock holds a connection, and the one who has it needs another
        with self._one_at_a_time, self._engine.begin() as connection:
            lock_transaction(connection, f"morph {self._kind} {self._owner}")
            # SQLite locks at the first statement that writes
            connection.execute(sa.delete(row).where(row.expires_at < now()))
            longer = sa.update(row).where(row.id == self._id).values(expires_at=expires_at)
            if connection.execute(longer).rowcount:
                return
            # what is stored between these two counts twice, which is better than not at all
            self.there = int(connection.execute(reserved).scalar_one()) + self._count()
            self.refused = self.there + self._left > self._limit
            if not self.refused:
                connection.execute(
                    sa.insert(row).values(
                        id=self._id,
                        kind=self._kind,
                        owner=self._owner,
                        count=self._left,
                        expires_at=expires_at,
                    )
                )

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
        mine = ReservationRow.id == self._id
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
        reservation = Reservation(
            self._engine, self._one_at_a_time, kind, owner, adding, limit, count
        )
        try:
            yield reservation
        finally:
            reservation.release()
