"""An older program leaves the database and the data directory of a newer one alone."""

from __future__ import annotations

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from chamfer_morph.worker import layout
from chamfer_morph.worker.layout import check_layout
from chamfer_morph.worker.settings import Settings
from morph_engine.errors import ConfigError


@pytest.fixture
def settings(tmp_path: Path, database_url: str) -> Settings:
    """Of an empty service, on SQLite and on Postgres."""
    return Settings(_env_file=None, data_dir=tmp_path, database_url=database_url)


@pytest.mark.parametrize("newer", ["database", "folder"])
def test_a_newer_layout_is_refused(
    settings: Settings, newer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each by itself, with what to do; what was there stays as it is."""
    check_layout(settings)
    check_layout(settings)  # and the same one is taken
    with monkeypatch.context() as later:
        later.setattr(layout, "LAYOUT", layout.LAYOUT + 1)
        check_layout(settings)
        check_layout(settings)
    file = settings.data_dir / "layout"
    assert file.read_text() == f"{layout.LAYOUT + 1}\n"
    if newer == "database":
        file.write_text(f"{layout.LAYOUT}\n")
    else:
        settings = settings.model_copy(
            update={"database_url": f"sqlite:///{settings.data_dir / 'other.sqlite'}"}
        )
    with pytest.raises(ConfigError, match=f"has layout {layout.LAYOUT + 1}"):
        check_layout(settings)


def test_processes_that_start_together_agree(settings: Settings) -> None:
    """API, janitor and workers of a new service note its layout at once."""
    check_layout(settings)
    together = threading.Barrier(6)

    def start(_: int) -> None:
        together.wait()
        check_layout(settings)

    with ThreadPoolExecutor(6) as starting:
        for _ in range(10):
            (settings.data_dir / "layout").unlink()
            list(starting.map(start, range(6)))
            assert (settings.data_dir / "layout").read_text() == f"{layout.LAYOUT}\n"


@pytest.mark.parametrize(
    "command",
    [["chamfer_morph.worker", "run"], ["chamfer_morph.worker", "janitor"],
     ["chamfer_morph.server", "check"], ["chamfer_morph.server", "api"]],
    ids=" ".join,
)  # fmt: skip
def test_each_process_refuses_it(tmp_path: Path, command: list[str]) -> None:
    """Before it touches a job, in two sentences."""
    (tmp_path / "layout").write_text("1000\n")
    done = subprocess.run(
        [sys.executable, "-m", *command],
        env={"MORPH_DATA_DIR": str(tmp_path)}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode and done.stderr.count("\n") == 2
    assert "newer version of morph" in done.stderr
