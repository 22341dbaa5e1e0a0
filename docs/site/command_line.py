"""The reference of the `morph` command, from the command's own help."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import typer
from typer.main import get_group

from chamfer_morph.cli.app import app
from chamfer_morph.cli.examples import EXAMPLES
from docs.site.markdown import code, row

NOT_SHOWN = {"--help", "--install-completion", "--show-completion"}
"""Options that every command has, or that are the shell's."""


def page() -> str:
    """All commands, in the order and under the headings of `morph --help`."""
    group = get_group(app)
    root = typer.Context(group, info_name="morph")
    lines = ["# Command line", "", group.help or "", "", _options_as_code(group.epilog or ""), ""]
    heading = None
    for name in group.list_commands(root):
        command = group.get_command(root, name)
        panel = getattr(command, "rich_help_panel", None)
        panel = panel if isinstance(panel, str) else "Commands"
        if panel != heading:
            heading = panel
            lines += [f"## {heading}", ""]
        lines += _command(command, name, root, level=3)
    return "\n".join(lines)


def _command(command: Any, name: str, parent: typer.Context, *, level: int) -> Iterator[str]:
    """Its heading, help, usage and options, and its commands."""
    context = typer.Context(command, info_name=name, parent=parent)
    usage = command.get_usage(context).removeprefix("Usage: ")
    yield from (f"{'#' * level} {context.command_path}", "", command.help or "", "")
    yield from ("```text", usage, "```", "")
    records = [each.get_help_record(context) for each in command.get_params(context)]
    shown = [each for each in records if each and each[0].split(",")[0] not in NOT_SHOWN]
    if shown:
        yield from (row("option", "meaning"), row("---", "---"))
        yield from (row(code(option), _options_as_code(meaning)) for option, meaning in shown)
        yield ""
    if examples := EXAMPLES.get(context.command_path.removeprefix("morph ")):
        yield from ("```text", *examples, "```", "")
    for child in getattr(command, "commands", {}).values():
        yield from _command(child, child.name, context, level=level + 1)


def _options_as_code(text: str) -> str:
    """Help in which options are set apart, as they are typed."""
    return re.sub(r"--[a-z-]+", r"`\g<0>`", text)
