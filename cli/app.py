"""The `morph` command: its commands by name, each of whose modules is imported when it is used."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_group

from chamfer_morph.cli.examples import epilog
from chamfer_morph.cli.exit_status import exit_status

_MODULES = {
    "run": ("run", "rerun"),
    "catalog": ("methods", "shapes", "presets"),
    "measurement": ("inspect", "metrics"),
    "benchmarks": ("bench",),
    "reproduction": ("reproduce",),
    "exports": ("export", "view", "render"),
    "jobs": (
        "submit", "jobs", "show", "watch", "next", "cancel", "retry", "resume", "fork", "delete",
        "fetch",
    ),
    "sharing": ("share",),
    "queue": ("queue",),
    "webhooks": ("webhooks",),
    "sweeps": ("sweep",),
    "processes": ("serve", "worker"),
    "doctor": ("doctor",),
    "backup": ("backup", "restore"),
    "service": ("keys", "workers"),
}  # fmt: skip

COMMANDS = {name: module for module, names in _MODULES.items() for name in names}
"""The module of each command, in the order of the help."""


class LazyGroup(TyperGroup):
    """Imports the module of a command when it is used; all of them for help or an unknown name."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of all commands."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name; None if there is none."""
        modules = {COMMANDS[cmd_name]} if cmd_name in COMMANDS else set(COMMANDS.values())
        for module in modules if cmd_name not in self.commands else ():
            commands = get_group(import_module(f"chamfer_morph.cli.commands.{module}").app).commands
            _add_examples(commands, "")
            self.commands.update(commands)
        return self.commands.get(cmd_name)


def _add_examples(commands: Mapping[str, Any], prefix: str) -> None:
    """Put examples below the help of these commands, and of those below them."""
    for name, command in commands.items():
        command.epilog = epilog(prefix + name)
        _add_examples(getattr(command, "commands", {}), f"{prefix}{name} ")


app: typer.Typer = typer.Typer(
    name="morph",
    cls=LazyGroup,
    help="Morph one 3D shape into another by differentiable physics.",
    epilog="Exit status: 0 success, 1 failed job or internal error (--debug shows the traceback), "
    "2 invalid input, 3 no answer from the service, 130 interrupted by Ctrl-C.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command that the arguments of the process name, and exit with its status."""
    arguments = sys.argv[1:]
    debug = "--debug" in arguments
    if debug:
        arguments.remove("--debug")
    sys.exit(
        exit_status(
            lambda: app(arguments, prog_name="morph", standalone_mode=False),
            as_json="--json" in arguments,
            debug=debug,
        )
    )


@app.callback()
def morph(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Morph one 3D shape into another by differentiable physics."""
    if version:
        from importlib.metadata import version as version_of

        typer.echo(f"chamfer-morph {version_of('chamfer-morph')}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())
