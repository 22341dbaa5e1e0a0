"""When a job was started is kept as it is cancelled, or runs out of time.

DBOS takes that time from the row of a workflow that it cancels. The database itself puts it back,
in the same transaction.
"""

from __future__ import annotations

import sqlalchemy as sa

from chamfer_morph.worker.own_queue import WORKFLOW

TRIGGER = "morph_keep_start"

_CANCELLED = (
    f"new.name = '{WORKFLOW}' and new.status = 'CANCELLED' and new.started_at_epoch_ms is null"
)


def create_trigger(connection: sa.Connection, workflows: str) -> None:
    """Let the database keep these times from now on; harmless to repeat.

    Args:
        connection: A transaction; on Postgres one that has the lock of `create_triggers`.
        workflows: Name of the table of workflows, with its schema.
    """
    if connection.dialect.name == "postgresql":
        _create_on_postgres(connection, workflows)
        return
    connection.execute(
        sa.text(
            f"create trigger if not exists {TRIGGER} after update of status on {workflows} "
            f"when {_CANCELLED} begin update {workflows} "
            "set started_at_epoch_ms = old.started_at_epoch_ms "
            "where workflow_uuid = new.workflow_uuid; end"
        )
    )


def _create_on_postgres(connection: sa.Connection, workflows: str) -> None:
    connection.execute(
        sa.text(
            f"create or replace function {TRIGGER}() returns trigger language plpgsql as $$ "
            "begin new.started_at_epoch_ms = old.started_at_epoch_ms; return new; end $$"
        )
    )
    known = sa.text(f"select 1 from pg_trigger where tgname = '{TRIGGER}'")
    if connection.execute(known).first() is None:
        connection.execute(
            sa.text(
                f"create trigger {TRIGGER} before update of status on {workflows} "
                f"for each row when ({_CANCELLED}) execute function {TRIGGER}()"
            )
        )
