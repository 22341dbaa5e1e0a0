"""Worker slots: their names, and pausing them, in a table that all hosts see."""

from __future__ import annotations

import re
import socket

import sqlalchemy as sa

from chamfer_morph.worker.tables import create_missing

_TABLE = sa.Table(
    "morph_worker_slots",
    sa.MetaData(),
    sa.Column("name", sa.String(255), primary_key=True),
    sa.Column("paused", sa.Boolean, nullable=False),
)


def executor_id(slot: int) -> str:
    """Name of a slot of this machine."""
    return f"{_host()}-slot{slot}"


def janitor_id() -> str:
    """Name of the janitor of this machine."""
    return f"{_host()}-janitor"


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9.-]", "-", socket.gethostname())


class WorkerSlots:
    """The table. Calls block.

    Args:
        engine: The database of the queue.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine
        create_missing(engine, _TABLE)

    def register(self, name: str) -> None:
        """Note that a slot works for this service."""
        if name not in self.all():
            try:
                with self._engine.begin() as connection:
                    connection.execute(sa.insert(_TABLE).values(name=name, paused=False))
            except sa.exc.IntegrityError:  # another process was quicker
                pass

    def unregister(self, name: str) -> None:
        """Forget a slot that has ended; a paused one stays, to be paused when it begins again."""
        gone = (_TABLE.c.name == name) & ~_TABLE.c.paused
        with self._engine.begin() as connection:
            connection.execute(sa.delete(_TABLE).where(gone))

    def all(self) -> dict[str, bool]:
        """Every slot that works for this service or has ended of late, and whether it is paused."""
        query = sa.select(_TABLE.c.name, _TABLE.c.paused).order_by(_TABLE.c.name)
        with self._engine.connect() as connection:
            return {name: paused for name, paused in connection.execute(query)}

    def is_paused(self, name: str) -> bool:
        """Whether a slot takes no new jobs."""
        query = sa.select(_TABLE.c.paused).where(_TABLE.c.name == name)
        with self._engine.connect() as connection:
            return bool(connection.execute(query).scalar_one_or_none())

    def pause(self, name: str, paused: bool = True) -> None:
        """Let a slot finish its job and take no other; or, not paused, let it take jobs again."""
        with self._engine.begin() as connection:
            change = sa.update(_TABLE).where(_TABLE.c.name == name).values(paused=paused)
            connection.execute(change)
