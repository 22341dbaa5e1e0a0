"""Workers behind a real PgBouncer: many of them share a few connections, and lose nothing."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psycopg
import pytest
import sqlalchemy as sa

from tests.acceptance.conftest import FRAMES, Cluster
from tests.conftest import empty_database
from tests.live_service import free_port

POOL_SIZE = 4
PATH = f"{os.environ.get('PATH', '')}:/usr/sbin"

pytestmark = pytest.mark.skipif(
    shutil.which("pgbouncer", path=PATH) is None,
    reason="pgbouncer is not installed",
)


@pytest.fixture
def database(postgres: str) -> Iterator[str]:
    """A Postgres database of the test's own."""
    with empty_database(postgres) as url:
        yield url


@pytest.fixture
def pooler(database: str, tmp_path: Path) -> Iterator[str]:
    """The same database through a pooler that hands connections out by transaction."""
    server, port = sa.make_url(database), free_port()
    config = tmp_path / "pgbouncer.ini"
    config.write_text(
        f"[databases]\n* = host={server.host} port={server.port or 5432} user={server.username}\n"
        f"[pgbouncer]\nlisten_addr = 127.0.0.1\nlisten_port = {port}\nunix_socket_dir =\n"
        f"auth_type = any\npool_mode = transaction\ndefault_pool_size = {POOL_SIZE}\n"
        "idle_transaction_timeout = 15\n",
        encoding="utf-8",
    )
    program = shutil.which("pgbouncer", path=PATH)
    command = [str(program), *(["-u", "nobody"] if os.getuid() == 0 else []), str(config)]
    with (tmp_path / "pgbouncer.log").open("wb") as log:
        process = subprocess.Popen(command, stderr=log, stdout=log)
    url = server.set(host="127.0.0.1", port=port).render_as_string(hide_password=False)
    try:
        for _ in range(100):
            try:
                psycopg.connect(url).close()
                break
            except psycopg.OperationalError:
                assert process.poll() is None, (tmp_path / "pgbouncer.log").read_text()
                time.sleep(0.1)
        yield url
    finally:
        process.kill()
        process.wait()


def test_many_workers_share_few_connections(
    new_cluster: Callable[..., Cluster], database: str, pooler: str, undisturbed: np.ndarray
) -> None:
    """Each keeps the one of its lock; a job whose worker is killed goes on with another."""
    cluster = new_cluster(database, database_pooler_url=pooler)
    workers = [cluster.worker(slot) for slot in range(3)]
    cluster.start("janitor")
    job = cluster.submit()
    cluster.wait_for_frame(job, FRAMES // 3)
    with psycopg.connect(database, autocommit=True) as connection:
        (count,) = connection.execute(
            "select count(*) from pg_stat_activity where datname = current_database() "
            "and pid <> pg_backend_pid()"
        ).fetchone() or (0,)
    assert count <= len(workers) + POOL_SIZE
    (owner,) = (worker for worker in workers if cluster.engines(worker))
    owner.kill()
    cluster.require_sound(job, undisturbed)
