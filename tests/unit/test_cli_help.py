"""The help of every command: examples that can be typed, and no word eaten by markup."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.main import get_group

from chamfer_morph.cli.app import app
from chamfer_morph.cli.examples import EXAMPLES


def commands(group: Any, context: typer.Context, path: str = "") -> Iterator[tuple[str, Any]]:
    """Commands that do something, by their path."""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if hasattr(command, "list_commands"):
            yield from commands(command, context, f"{path}{name} ")
            if not command.invoke_without_command:
                continue
        yield path + name, command


GROUP = get_group(app)
ROOT = typer.Context(GROUP, info_name="morph")
COMMANDS = dict(commands(GROUP, ROOT))


def test_every_command_has_an_example() -> None:
    """And there is none of a command that is not there."""
    assert set(EXAMPLES) == set(COMMANDS)


def test_a_group_has_examples_of_its_commands() -> None:
    """Whoever asks for help on `morph keys` sees how each of its commands is called."""
    keys = GROUP.get_command(ROOT, "keys")
    shown = keys.get_help(typer.Context(keys, info_name="keys", parent=ROOT)) + keys.epilog
    for name in keys.commands:
        assert f"morph keys {name}" in shown


@pytest.mark.parametrize("path", EXAMPLES)
def test_examples_can_be_typed(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their options exist and take such values."""
    monkeypatch.delenv("MORPH_SERVER", raising=False)
    for example in EXAMPLES[path]:
        words = shlex.split(example)
        while "=" in words[0]:  # a variable
            words.pop(0)
        assert words[: 1 + len(path.split())] == ["morph", *path.split()]
        arguments = words[1 + len(path.split()) :]
        COMMANDS[path].make_context(path, arguments, parent=ROOT)


@pytest.mark.parametrize("path", COMMANDS)
def test_brackets_are_shown(path: str) -> None:
    """What stands in brackets is markup unless a backslash says otherwise."""
    texts = [COMMANDS[path].help, *(getattr(each, "help", "") for each in COMMANDS[path].params)]
    for text in filter(None, texts):
        assert not re.search(r"(?<!\\)\[", text), text
