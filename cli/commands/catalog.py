"""Commands on what there is to choose from: methods, shapes and presets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chamfer_morph.cli.options import JsonOption, MethodOption, QuietOption
from chamfer_morph.cli.output import print_json, print_result
from morph_engine.optional_packages import require

if TYPE_CHECKING:
    from chamfer_morph.cli.mesh_fetch import FetchedMesh

app: typer.Typer = typer.Typer()
shapes: typer.Typer = typer.Typer(invoke_without_command=True)
app.add_typer(shapes, name="shapes")


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


@shapes.callback()
def list_shapes(context: typer.Context, as_json: JsonOption = False) -> None:
    """List the built-in shapes; text:HELLO makes extruded letters of any string."""
    if context.invoked_subcommand:
        return
    from morph_engine.geometry.shapes import names

    text = "\n".join((*names(), "text:ANY STRING"))
    print_result({"shapes": list(names())}, text, as_json=as_json)


@shapes.command()
def fetch(
    meshes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[MESH...]", help="File names such as cow.obj; default: all."),
    ] = None,
    to: Annotated[
        Path, typer.Option("--to", envvar="MORPH_MESHES", help="Folder to save them in.")
    ] = Path("meshes"),
    place: Annotated[
        str,
        typer.Option(
            "--from", metavar="PLACE", help="URL or folder to get the originals from instead."
        ),
    ] = "",
    checksums: Annotated[
        Path | None,
        typer.Option(
            help="File with the SHA-256 that the originals must have, as written by sha256sum."
        ),
    ] = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Fetch the public originals of the paper's meshes and place them as in the paper.

    If repeated, it continues where it stopped, and checks the files that are there.
    """
    require("httpx", extra="reproduce", purpose="Fetching meshes")
    from chamfer_morph.cli.mesh_fetch import fetch_meshes

    fetched = fetch_meshes(to, meshes or None, place=place, checksums=checksums, quiet=quiet)
    print_result(
        {"folder": str(to), "meshes": fetched}, lambda: _print_fetched(fetched), as_json=as_json
    )


def _print_fetched(meshes: list[FetchedMesh]) -> None:
    """A line a mesh: where it is from, and whether it is the paper's."""
    from chamfer_morph.cli.tables import print_table

    is_papers = {True: "no, a stand-in", False: "yes", None: ""}
    rows = [
        (
            mesh.name,
            mesh.original or mesh.origin,
            mesh.sha256,
            mesh.checked,
            is_papers[mesh.stands_in],
        )
        for mesh in meshes
    ]
    print_table(("mesh", "from", "SHA-256 of the original", "", "the paper's"), rows)


@app.command()
def presets(
    name: Annotated[str | None, typer.Argument(help="Show the settings of this preset.")] = None,
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
