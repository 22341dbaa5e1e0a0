"""Options and arguments that several commands share, each declared once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from morph_engine.device import Device

if TYPE_CHECKING:
    from chamfer_morph.client import MorphClient

SHAPE_HELP = "A mesh file (OBJ, PLY, STL, OFF, GLB) or a built-in shape (see morph shapes)."
FIT_HELP = "Scale to the usual volume, to touch the domain, or keep the file's coordinates."

Fit = Literal["volume", "extent", "none"]

# what to morph

TargetArgument = Annotated[str, typer.Argument(metavar="TARGET", help="What it is to become.")]
MethodOption = Annotated[str | None, typer.Option(help="See morph methods.")]
PresetOption = Annotated[str, typer.Option(help="See morph presets.")]
FrameCountOption = Annotated[int | None, typer.Option(help="Frames to compute.")]
PointsOption = Annotated[
    int | None, typer.Option(help="Particles per grid cell edge: 2 quick, 3 usual, 4 fine.")
]
FitOption = Annotated[Fit | None, typer.Option(help=FIT_HELP)]
SeedOption = Annotated[int | None, typer.Option(help="Seed of every random choice.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Any setting; see morph presets fast."),
]
DeviceOption = Annotated[Device, typer.Option(help="Where to compute.")]

# results

FramesOption = Annotated[
    str | None, typer.Option(help="As in 0,5,10-20; -1 is the last. All if not given.")
]
ResultFileOption = Annotated[
    Path | None, typer.Option(help="Result file; SOURCE-to-TARGET.vtkhdf if not given.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace a file.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Show no progress.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]

# jobs of a service

JobArgument = Annotated[str, typer.Argument(metavar="JOB", help="Id of a job.")]
PriorityOption = Annotated[int, typer.Option(help="1 to 1000; smaller runs earlier among yours.")]
TimeoutOption = Annotated[
    float | None, typer.Option(help="Stop a job that computes for longer [s].")
]
NameOption = Annotated[str, typer.Option(help="A name for your own use.")]
IdempotencyKeyOption = Annotated[
    str | None,
    typer.Option(metavar="KEY", help="Commands with the same key have one effect between them."),
]
WatchOption = Annotated[bool, typer.Option("--watch", help="Show progress until the end.")]
ServerOption = Annotated[
    str | None,
    typer.Option(
        envvar="MORPH_SERVER", help="Address of the service; http://127.0.0.1:8000 if not given."
    ),
]
KeyOption = Annotated[
    str | None, typer.Option(envvar="MORPH_KEY", help="API key; better in MORPH_KEY.")
]


def connect(server: str | None, key: str | None) -> MorphClient:
    """A client for the service of `--server` and `--key`; nothing is sent yet.

    Raises:
        ServiceError: The address or the key cannot be one.
    """
    from chamfer_morph.client import MorphClient

    return MorphClient(server, key=key)
