"""Which layout database and data directory have, so that no older program works on a newer one."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import sqlalchemy as sa

from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.tables import create_missing
from morph_engine.errors import ConfigError
from morph_engine.files import replacing, wait_for

LAYOUT = 1
"""Layout that this program reads and writes; one more where an older program would do harm.

Tables and columns that an older program need not know leave it as it is."""

_TABLE = sa.Table(
    "morph_layouts",
    sa.MetaData(),
    sa.Column("version", sa.Integer, primary_key=True, autoincrement=False),
)
"""Every layout that the database has had."""


def check_layout(settings: Settings) -> None:
    """Note the layout of the database and of the data directory, unless they have a newer one.

    Raises:
        ConfigError: They have.
    """
    file = settings.data_dir / "layout"
    engine = database(settings)
    try:
        create_missing(engine, _TABLE)
        with engine.connect() as connection:
            stored = connection.execute(sa.select(sa.func.max(_TABLE.c.version))).scalar_one() or 0
        for where, found in (("The database", stored), (f"{settings.data_dir}", _read(file))):
            if found > LAYOUT:
                raise ConfigError(
                    f"{where} was written by a newer version of morph: it has layout "
                    f"{found}, and this version supports {LAYOUT}.",
                    "Install the newer version here, too, or restore an earlier backup.",
                )
        if stored < LAYOUT:
            with suppress(sa.exc.IntegrityError), engine.begin() as connection:
                connection.execute(sa.insert(_TABLE).values(version=LAYOUT))
    finally:
        engine.dispose()
    if _read(file) < LAYOUT:
        with wait_for(file.with_suffix(".lock")):  # API, janitor and workers start together
            if _read(file) < LAYOUT:
                with replacing(file) as path:
                    path.write_text(f"{LAYOUT}\n", encoding="ascii")


def _read(file: Path) -> int:
    """The number in a file; 0 where there is none, as before layouts had numbers."""
    try:
        return int(file.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0
