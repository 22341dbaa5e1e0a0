"""What owners may do with the order of their own jobs: priorities, which is next, and a pause.

Jobs of an owner who has paused wait under the name of another queue, which no worker looks into.
None of it gives an owner a place that was another's.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa

from chamfer_morph.schemas import JobState
from chamfer_morph.worker.dbos_adapter import WorkflowTable
from chamfer_morph.worker.job_state import statuses
from chamfer_morph.worker.locks import lock_transaction
from chamfer_morph.worker.places import apart, in_own_order, rank_in_front

WORKFLOW = "morph"
QUEUE = "jobs"
PAUSED_QUEUE = "paused"

NOBODY = "-"
"""Owner of jobs submitted without a key."""

ENQUEUED: sa.ColumnElement[str] = sa.literal_column("'ENQUEUED'")
PENDING: sa.ColumnElement[str] = sa.literal_column("'PENDING'")
"""Not as parameters, for which SQLite uses no partial index."""

_PAUSED_OWNERS = sa.Table(
    "morph_paused_owners",
    sa.MetaData(),
    sa.Column("owner", sa.String(64), primary_key=True),
    sa.Column("since", sa.BigInteger, nullable=False),
)
"""Since when, in milliseconds since 1970."""


class OwnQueue:
    """The queued jobs of single owners. Calls block; an owner is named as its column has it."""

    def __init__(self, workflows: WorkflowTable) -> None:
        self._workflows = workflows

    def create_table(self) -> None:
        """Create what is missing."""
        self._workflows.create_missing(_PAUSED_OWNERS)

    def is_paused(self, owner: str) -> bool:
        """Whether no more jobs of an owner are started."""
        query = sa.select(_PAUSED_OWNERS.c.owner).where(_PAUSED_OWNERS.c.owner == owner)
        return bool(self._workflows.rows(query))

    def queue_of(self, owner: str) -> str:
        """The queue that jobs of an owner wait in."""
        return PAUSED_QUEUE if self.is_paused(owner) else QUEUE

    def pause(self, owner: str) -> None:
        """Start no more jobs of an owner; those that run go on."""
        row = {"owner": owner, "since": round(time.time() * 1000)}
        with self._giving_places(owner) as connection:
            connection.execute(sa.delete(_PAUSED_OWNERS).where(_PAUSED_OWNERS.c.owner == owner))
            connection.execute(sa.insert(_PAUSED_OWNERS).values(row))
            self._move(connection, owner, PAUSED_QUEUE)

    def unpause(self, owner: str, first_place: int) -> None:
        """Start jobs of an owner again, from this place in the queue on."""
        with self._giving_places(owner) as connection:
            connection.execute(sa.delete(_PAUSED_OWNERS).where(_PAUSED_OWNERS.c.owner == owner))
            paused = connection.execute(self._waiting(owner, PAUSED_QUEUE)).all()
            for place, (job, *_) in enumerate(in_own_order(paused), first_place):
                self._change(connection, job, queue_name=QUEUE, priority=place)

    def settle(self, owner: str) -> None:
        """Move jobs that were queued while their owner paused, or ended a pause."""
        paused = sa.select(_PAUSED_OWNERS.c.owner).where(_PAUSED_OWNERS.c.owner == owner)
        with self._giving_places(owner) as connection:
            queue = PAUSED_QUEUE if connection.execute(paused).first() else QUEUE
            self._move(connection, owner, queue)

    def move_finished(self, job_id: str, place: int) -> None:
        """Give a finished job the place that it has once it is queued again."""
        c = self._workflows.table.c
        finished = c.status.not_in(
            [status for state in JobState if not state.finished for status in statuses(state)]
        )
        with self._workflows.begin() as connection:
            connection.execute(
                sa.update(self._workflows.table)
                .where(c.workflow_uuid == job_id, finished)
                .values(priority=place)
            )

    def put_first(self, owner: str, job_id: str) -> bool:
        """Start a queued job before all others of its owner; False if it is not queued."""
        c = self._workflows.table.c
        with self._workflows.begin() as connection:
            query = sa.select(c.attributes, c.queue_name).where(
                c.workflow_uuid == job_id, c.status == ENQUEUED
            )
            row = connection.execute(query.with_for_update()).one_or_none()
            if row is None:
                return False
            attributes, queue = row
            others = connection.execute(self._waiting(owner, queue)).all()
            rank = rank_in_front(others, time.time_ns() // 1000)
            self._change(connection, job_id, attributes=(attributes or {}) | {"first": rank})
        self.order(owner)
        return True

    def order(self, owner: str) -> None:
        """Give the queued jobs of an owner their places in the order that the owner wants.

        Each has one of its own, or others would wait behind all that share one.
        """
        with self._giving_places(owner) as connection:
            jobs = connection.execute(self._waiting(owner, QUEUE)).all()
            places = apart(place for _, place, *_ in jobs)
            for (job, place, *_), better in zip(in_own_order(jobs), places, strict=True):
                if place != better:
                    self._change(connection, job, priority=better)

    def order_newest(self, owner: str, job_id: str, priority: int) -> None:
        """The same after a job of this priority has been queued; often there is nothing to do."""
        c = self._workflows.table.c
        later = c.attributes["priority"].as_integer() > priority
        moved = c.attributes["first"].as_string().is_not(None)
        newest = self._workflows.table.alias()
        its_place = sa.select(newest.c.priority).where(newest.c.workflow_uuid == job_id)
        shared = (c.priority == its_place.scalar_subquery()) & (c.workflow_uuid != job_id)
        if self._workflows.rows(self._waiting(owner, QUEUE).where(later | moved | shared).limit(1)):
            self.order(owner)

    @contextmanager
    def _giving_places(self, owner: str) -> Iterator[sa.Connection]:
        """A transaction that gives places to jobs of an owner, one at a time for each of them."""
        with self._workflows.begin() as connection:
            lock_transaction(connection, f"morph places {owner}")
            yield connection

    def _move(self, connection: sa.Connection, owner: str, queue: str) -> None:
        c = self._workflows.table.c
        elsewhere = QUEUE if queue == PAUSED_QUEUE else PAUSED_QUEUE
        connection.execute(
            sa.update(self._workflows.table)
            .where(c.queue_name == elsewhere, self._is_queued, self._is_of(owner))
            .values(queue_name=queue)
        )

    def _waiting(self, owner: str, queue: str) -> sa.Select[Any]:
        """Id, place, priority and time of moving to the front of an owner's jobs, by age."""
        c = self._workflows.table.c
        priority = c.attributes["priority"].as_integer()
        first = c.attributes["first"].as_string()
        return (
            sa.select(c.workflow_uuid, c.priority, priority, first)
            .where(c.name == WORKFLOW, c.queue_name == queue, self._is_queued)
            .where(self._is_of(owner))
            .order_by(c.created_at, c.workflow_uuid)
        )

    @property
    def _is_queued(self) -> sa.ColumnElement[bool]:
        """Whether a job is queued, with the words of DBOS's index, which SQLite wants to read."""
        c = self._workflows.table.c
        return c.status.in_([ENQUEUED, PENDING]) & (c.status == ENQUEUED)

    def _is_of(self, owner: str) -> sa.ColumnElement[bool]:
        """Not by the index of owners: few jobs are left by the other conditions."""
        return sa.func.coalesce(self._workflows.table.c.authenticated_user, NOBODY) == owner

    def _change(self, connection: sa.Connection, job_id: str, **values: Any) -> None:
        """Change the row of a job that is still queued."""
        c = self._workflows.table.c
        connection.execute(
            sa.update(self._workflows.table)
            .where(c.workflow_uuid == job_id, c.status == ENQUEUED)
            .values(values)
        )
