"""Messages about jobs, written by the database itself in the transaction that changes a job.

Whoever changes the state of a job (a worker, the API, the janitor, DBOS on its own) thereby writes
the messages about it, by a trigger. A process that is killed at any instant leaves both or neither.
"""

from __future__ import annotations

import sqlalchemy as sa

from chamfer_morph.worker.job_state import STATUSES, job_state
from chamfer_morph.worker.own_queue import NOBODY, WORKFLOW

LOCK = 7310251
"""Of Postgres, which has no `create trigger if not exists`."""

_FUNCTION = "morph_record_job_change"


def create_triggers(connection: sa.Connection, workflows: str) -> None:
    """Let the database write messages from now on; harmless to repeat.

    Args:
        connection: A transaction.
        workflows: Name of the table of workflows, with its schema.
    """
    if connection.dialect.name == "postgresql":
        _create_on_postgres(connection, workflows)
    else:
        _create_on_sqlite(connection, workflows)


def _create_on_postgres(connection: sa.Connection, workflows: str) -> None:
    now = "cast(extract(epoch from clock_timestamp()) * 1000 as bigint)"
    message_id = "replace(cast(gen_random_uuid() as varchar), '-', '')"
    connection.execute(sa.text(f"select pg_advisory_xact_lock({LOCK})"))
    _execute(
        connection,
        f"""create or replace function {_FUNCTION}() returns trigger language plpgsql
        set search_path from current as $$
        begin
            if tg_op = 'INSERT' or {_state("old")} <> {_state("new")} then
                {_insertion(message_id, now)};
            end if;
            return null;
        end $$""",
    )
    known = sa.text("select 1 from pg_trigger where tgname = 'morph_job_change'")
    if connection.execute(known).first() is None:
        _execute(
            connection,
            f"create trigger morph_job_change after insert or update of status on {workflows} "
            f"for each row when (new.name = '{WORKFLOW}') execute function {_FUNCTION}()",
        )


def _create_on_sqlite(connection: sa.Connection, workflows: str) -> None:
    now = "cast((julianday('now') - 2440587.5) * 86400000 as integer)"
    insertion = _insertion("lower(hex(randomblob(16)))", now)
    _execute(
        connection,
        f"create trigger if not exists morph_job_insertion after insert on {workflows} "
        f"when new.name = '{WORKFLOW}' begin {insertion}; end",
    )
    _execute(
        connection,
        f"create trigger if not exists morph_job_change after update of status on {workflows} "
        f"when new.name = '{WORKFLOW}' and {_state('old')} <> {_state('new')} "
        f"begin {insertion}; end",
    )


def _execute(connection: sa.Connection, statement: str) -> None:
    connection.execute(sa.text(statement))


def _insertion(message_id: str, now: str) -> str:
    """A message to each webhook of the owner that wants to know the new state."""
    owner = f"coalesce(nullif(new.authenticated_user, '{NOBODY}'), '')"
    return f"""insert into morph_webhook_messages (id, webhook, type, job, created_at, due_at)
        select {message_id}, id, 'job.' || {_state("new")}, new.workflow_uuid, {now}, {now}
        from morph_webhooks
        where owner = {owner} and ' ' || states || ' ' like '% ' || {_state("new")} || ' %'"""


def _state(row: str) -> str:
    """The state of the job in a row, as `job_state` tells it."""
    late = f"coalesce({row}.completed_at >= {row}.workflow_deadline_epoch_ms, false)"
    cases = [
        f"when {row}.status = '{status}' and {late} = {str(is_late).lower()} "
        f"then '{job_state(status, late=is_late).value}'"
        for status in STATUSES
        for is_late in (False, True)
    ]
    return f"(case {' '.join(cases)} end)"
