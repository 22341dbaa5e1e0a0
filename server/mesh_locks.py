"""One lock for each mesh, over all API processes: what looks whether it is used, and acts on that.

Who deletes a mesh must not be overtaken by a job that begins to use it, nor by an upload of the
same file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager

import sqlalchemy as sa

from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.locks import lock_transaction
from chamfer_morph.worker.settings import Settings
from morph_engine.files import wait_for


class MeshLocks:
    """The locks: of Postgres, or files beside SQLite. Calls block.

    Args:
        settings: Where they are.
    """

    def __init__(self, settings: Settings) -> None:
        self._folder = settings.data_dir / "locks"
        self._folder.mkdir(parents=True, exist_ok=True)
        # connections of their own: who waits for a lock must not keep one from who has it
        self._engine = database(settings, kept=1) if settings.on_postgres else None

    @contextmanager
    def holding(self, digests: Iterable[str]) -> Iterator[None]:
        """Keep others from using, storing and deleting some meshes until the end of the body."""
        with ExitStack() as stack:
            if self._engine is None:  # few files in place of one for each mesh, which would stay
                for name in sorted({f"meshes-{digest[:2]}" for digest in digests}):
                    stack.enter_context(wait_for(self._folder / name))
            elif ordered := sorted({*digests}):  # or two might wait for each other
                connection = stack.enter_context(self._engine.begin())
                connection.execute(sa.text("set local idle_in_transaction_session_timeout = 0"))
                for digest in ordered:
                    lock_transaction(connection, f"morph mesh {digest}")
            yield

    def close(self) -> None:
        """Give the connections back."""
        if self._engine is not None:
            self._engine.dispose()
