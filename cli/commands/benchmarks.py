"""The command that runs the benchmarks of a checkout: bench."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from morph_engine.errors import MorphError

app: typer.Typer = typer.Typer()


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def bench(context: typer.Context) -> None:
    """Compare speed with similar software on this machine; other arguments go to the benchmarks."""
    import subprocess

    root = Path(__file__).resolve().parents[2]
    if not (root / "benchmarks").is_dir():
        raise MorphError(
            "The benchmarks are part of the source code, not of the installed package.",
            "Clone the repository and run make bench there.",
        )
    command = [sys.executable, "-m", "benchmarks", *context.args]
    raise typer.Exit(subprocess.run(command, cwd=root, check=False).returncode)
