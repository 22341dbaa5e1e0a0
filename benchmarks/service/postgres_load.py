"""What a service asks of its Postgres database, as Postgres counts it."""

from __future__ import annotations

import psycopg

CONNECTIONS = """
    select count(*) from pg_stat_activity
    where datname = current_database() and pid != pg_backend_pid()
"""
TRANSACTIONS = """
    select xact_commit + xact_rollback from pg_stat_database where datname = current_database()
"""


def connections_to(url: str) -> int:
    """Connections to a database, none of them being this one."""
    return _count(url, CONNECTIONS)


def transactions_of(url: str) -> int:
    """Transactions of a database since its statistics began; sessions report them within 10 s."""
    return _count(url, TRANSACTIONS)


def _count(url: str, query: str) -> int:
    with psycopg.connect(url) as connection:
        found = connection.execute(query).fetchone()
    assert found is not None
    return int(found[0])
