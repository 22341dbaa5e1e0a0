"""The database of the service as one file, taken at one instant while others write to it.

SQLite copies itself; for Postgres this runs `pg_dump` and `pg_restore`, which come with it.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path

import sqlalchemy as sa

from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.settings import Settings
from morph_engine.errors import ConfigError, ExtraError, MorphError
from morph_engine.files import replacing

SYSTEM_SCHEMAS = ("pg_catalog", "information_schema")


class DatabaseDumpError(MorphError):
    """A database could not be dumped or loaded."""


def dump(settings: Settings, path: Path) -> None:
    """Write the database as it is now.

    Raises:
        ConfigError: There is none.
        DatabaseDumpError: It cannot be dumped, or the disk refuses.
        ExtraError: `pg_dump` is not here.
    """
    with replacing(path) as temporary:
        if settings.on_postgres:
            _run(settings, "pg_dump", "--format=custom", "--no-owner", f"--file={temporary}")
            return
        source = _sqlite_file(settings)
        if not source.is_file():
            raise ConfigError(
                f"There is no database {source}.",
                "Name the data directory of the service in MORPH_DATA_DIR.",
            )
        with closing(sqlite3.connect(source)) as here, closing(sqlite3.connect(temporary)) as there:
            here.backup(there)


def load(settings: Settings, path: Path) -> None:
    """Fill the database, which has no tables yet, from a dump: all of it or nothing.

    Raises:
        DatabaseDumpError: It cannot be loaded.
        ExtraError: `pg_restore` is not here.
    """
    if settings.on_postgres:
        _run(settings, "pg_restore", "--no-owner", "--single-transaction", str(path))
        return
    with replacing(_sqlite_file(settings)) as temporary:
        shutil.copyfile(path, temporary)


def has_tables(settings: Settings) -> bool:
    """Whether the database is in use already."""
    if not settings.on_postgres:
        return _sqlite_file(settings).exists()
    engine = database(settings)
    try:
        found = sa.inspect(engine)
        schemas = set(found.get_schema_names()) - set(SYSTEM_SCHEMAS)
        return any(found.get_table_names(schema) for schema in schemas)
    finally:
        engine.dispose()


def _sqlite_file(settings: Settings) -> Path:
    return Path(sa.make_url(settings.system_database_url).database or "")


def _run(settings: Settings, program: str, *arguments: str) -> None:
    """Run a program of Postgres; the password is not among what other users can see of it."""
    if shutil.which(program) is None:
        raise ExtraError(f"{program} is not installed.", "apt-get install postgresql-client")
    url = sa.make_url(settings.system_database_url).set(drivername="postgresql")
    password = {"PGPASSWORD": str(url.password)} if url.password else {}
    address = url.set(password=None).render_as_string()
    done = subprocess.run(
        [program, f"--dbname={address}", *arguments],
        env=os.environ | password, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise DatabaseDumpError(
            f"{program} failed: {done.stderr.strip() or done.returncode}",
            "Fix this and repeat the command; it continues where it stopped.",
        )
