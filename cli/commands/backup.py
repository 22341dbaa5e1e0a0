"""Commands that copy the whole service, and make it anew from the copy."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chamfer_morph.cli.options import JsonOption, QuietOption
from chamfer_morph.cli.tables import format_size
from morph_engine.errors import ResourceError

if TYPE_CHECKING:
    from chamfer_morph.server.backup.backup import BackupRecord

PANEL = "The service"

app: typer.Typer = typer.Typer()


@app.command(rich_help_panel=PANEL)
def backup(
    folder: Annotated[
        Path, typer.Argument(help="Folder for the backup; an earlier backup there is updated.")
    ],
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Copy meshes, jobs, results and the database of this machine's service into a folder.

    The service may keep running: after a restore, running jobs continue from the last frame that
    was copied. The service is found through the MORPH_* variables, as by morph serve. With an
    object store only the database is copied. For Postgres this runs pg_dump.
    """
    from chamfer_morph.server.backup.backup import back_up
    from chamfer_morph.worker.private_process import keep_private
    from chamfer_morph.worker.settings import load_settings

    keep_private()
    with _explaining("backup", folder), _counting(quiet=quiet) as on_copied:
        record = back_up(load_settings(), folder, on_copied)
    _print(record, folder, f"morph restore {folder}", as_json=as_json)


@app.command(rich_help_panel=PANEL)
def restore(
    folder: Annotated[Path, typer.Argument(help="A folder made by morph backup.")],
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Restore the service from a backup, into MORPH_DATA_DIR and an empty database.

    Then start it: jobs that were running continue.
    """
    from chamfer_morph.server.backup.backup import restore as restore_service
    from chamfer_morph.worker.private_process import keep_private
    from chamfer_morph.worker.settings import load_settings

    keep_private()
    settings = load_settings()
    with _explaining("restore", settings.data_dir), _counting(quiet=quiet) as on_copied:
        record = restore_service(settings, folder, on_copied)
    _print(record, folder, "morph serve", as_json=as_json)


@contextmanager
def _explaining(what: str, target: Path) -> Iterator[None]:
    """Tell what stops a copy into a folder.

    Raises:
        ResourceError: A file cannot be read, or the disk refuses.
    """
    try:
        yield
    except (OSError, sqlite3.OperationalError) as error:
        path = getattr(error, "filename", None) or target
        reason = getattr(error, "strerror", None) or error
        raise ResourceError(
            f"The {what} has stopped at {path} ({reason}).",
            f"Check that {target} can be written to and has free space, and that you may read the "
            "files of the service; then repeat the command, which continues where it stopped.",
        ) from error


@contextmanager
def _counting(*, quiet: bool) -> Iterator[Callable[[int], None]]:
    """Show how much is copied; yields what to call with each file's size [bytes]."""
    from rich.progress import TextColumn

    from chamfer_morph.cli.progress_display import ProgressDisplay

    copied = [0, 0]
    with ProgressDisplay(TextColumn("{task.description}"), quiet=quiet) as display:
        show = display.add_text()

        def on_copied(size: int) -> None:
            copied[:] = copied[0] + 1, copied[1] + size
            show(f"{copied[0]:,} files copied, {format_size(copied[1])}")

        yield on_copied
        display.print(f"{copied[0]:,} files copied, {format_size(copied[1])}")


def _print(record: BackupRecord, folder: Path, following: str, *, as_json: bool) -> None:
    from chamfer_morph.cli.output import print_result

    text = (
        f"{folder}: {record.files:,} files, {format_size(record.bytes)}, and the database "
        f"({record.database}), of {record.finished_at:%Y-%m-%d %H:%M} UTC\nnext: {following}"
    )
    print_result(record, text, as_json=as_json)
