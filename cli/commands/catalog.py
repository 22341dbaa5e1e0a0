"""Commands that list what there is to choose from: methods, shapes and presets."""

from __future__ import annotations

from typing import Annotated

import typer

from chamfer_morph.cli.options import JsonOption, MethodOption
from chamfer_morph.cli.output import print_json, print_result

app: typer.Typer = typer.Typer()


@app.command()
def methods(as_json: JsonOption = False) -> None:
    """List the methods."""
    from chamfer_morph.cli.tables import print_table
    from morph_engine import methods as known

    rows = {name: known.options_of(name).summary() for name in known.names()}
    if as_json:
        print_json({"methods": rows})
    else:
        print_table(("method", "what it does"), rows.items())


@app.command()
def shapes(as_json: JsonOption = False) -> None:
    """List the built-in shapes; text:HELLO makes extruded letters of any string."""
    from morph_engine.geometry.shapes import names

    text = "\n".join((*names(), "text:ANY STRING"))
    print_result({"shapes": list(names())}, text, as_json=as_json)


@app.command()
def presets(
    name: Annotated[str | None, typer.Argument(help="Show the settings of this one.")] = None,
    describe: Annotated[
        str | None, typer.Option(metavar="SECTION", help="Only settings of this section.")
    ] = None,
    method: MethodOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the presets, or every setting of one with its meaning and range."""
    from chamfer_morph.cli.tables import print_settings, print_table
    from morph_engine import presets as known

    overrides = {"method": method} if method else {}
    if as_json:
        chosen = [name] if name else known.names()
        configs = {each: known.configure(each, overrides) for each in chosen}
        print_json({each: config.model_dump(mode="json") for each, config in configs.items()})
    elif name or describe or method:
        print_settings(known.configure(name or known.DEFAULT, overrides), section=describe)
    else:
        print_table(
            ("preset", "what it is"), ((each, known.describe(each)) for each in known.names())
        )
