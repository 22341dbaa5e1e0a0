"""The command that looks whether a machine has what morphs need."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Annotated

import typer

from chamfer_morph.cli.options import JsonOption

PANEL = "The service"

MARKS = {"ok": "✓", "warning": "!", "fault": "✗"}

app: typer.Typer = typer.Typer()


@app.command(rich_help_panel=PANEL)
def doctor(
    compute: Annotated[
        bool, typer.Option("--compute/--no-compute", help="Also compute a tiny morph.")
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Check whether this machine has what morphs and the service need, and say what to fix.

    Checks software, libraries, memory, disk, database, object store, and a tiny morph; the
    MORPH_* variables tell which service. Exit status 1 if a check fails.
    """
    from chamfer_morph.cli.doctor import examine
    from chamfer_morph.cli.output import print_json

    findings = []
    for finding in examine(compute=compute):
        findings.append(finding)
        if not as_json:
            sys.stdout.write(f"{MARKS[finding.verdict]} {finding.subject}: {finding.text}\n")
            sys.stdout.write(f"    {finding.remedy}\n" if finding.remedy else "")
            sys.stdout.flush()
    if as_json:
        print_json({"findings": [asdict(finding) for finding in findings]})
    raise typer.Exit(int(any(finding.verdict == "fault" for finding in findings)))
