"""Options and arguments that several commands share, each declared once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand, TyperOption

from chamfer_morph.cli.arguments import parse_settings, read_landmarks
from chamfer_morph.cli.output import print_result

if TYPE_CHECKING:
    from chamfer_morph.client import MorphClient

SHAPE_HELP = (
    "A mesh file (OBJ, PLY, STL, OFF, GLB, or a ZIP of one with its textures) or a built-in shape "
    "(see morph shapes)."
)
FIT_HELP = (
    "Scale and centre shapes only if they need it (auto), each to the usual volume, each to "
    "span the domain, or never."
)

ROTATE_HELP = "Rotate the source about x, y and z through its centre, about z first \\[degrees]."

Fit = Literal["auto", "volume", "extent", "none"]

TargetArguments = Annotated[
    list[str],
    typer.Argument(
        metavar="TARGET...", help="The shape to morph into; or several, one after the other."
    ),
]
MethodOption = Annotated[str | None, typer.Option(help="See morph methods.")]


class MethodCommand(TyperCommand):
    """A command with the option `--method`, whose help names the methods that are installed."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help; only this needs the methods."""
        from morph_engine.methods import names

        for option in self.params:
            if option.name == "method" and isinstance(option, TyperOption):
                option.help = f"One of {', '.join(names())}; see morph methods."
        super().format_help(ctx, formatter)


SeedOption = Annotated[int | None, typer.Option(help="Random seed.")]
DeviceOption = Annotated[
    Literal["auto", "cpu", "cuda", "vulkan", "metal"], typer.Option(help="Where to compute.")
]
ResultFileOption = Annotated[
    Path | None, typer.Option(help="Result file; default: SOURCE-to-TARGET.vtkhdf.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]
WatchOption = Annotated[bool, typer.Option("--watch", help="Show progress until the job ends.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Do not show progress.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
KeyOption = Annotated[
    str | None, typer.Option(envvar="MORPH_KEY", help="API key; better set in MORPH_KEY.")
]


@dataclass(frozen=True)
class ConfigOptions:
    """The configuration of a morph: a preset, and settings in place of its own."""

    preset: Annotated[str, typer.Option(help="See morph presets.")] = "fast"
    frames: Annotated[int | None, typer.Option(help="Frames to compute for each target.")] = None
    points_per_cell_edge: Annotated[
        int | None, typer.Option(help="Particles per grid cell edge: 2 quick, 3 normal, 4 fine.")
    ] = None
    fit: Annotated[Fit | None, typer.Option(help=FIT_HELP)] = None
    up: Annotated[
        Literal["auto", "y", "z"] | None,
        typer.Option(help="The upward axis of both shapes; auto: from each file."),
    ] = None
    source_rotate: Annotated[str | None, typer.Option(metavar="X,Y,Z", help=ROTATE_HELP)] = None
    target_rotate: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="The same for the target.")
    ] = None
    landmark: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,Z:X,Y,Z",
            help="A point of the source, and the point of the target where it ends.",
        ),
    ] = None
    landmarks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File with such pairs in JSON: \\[{source: \\[x, y, z], target: ...}].",
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PATH=VALUE", help="Any setting; see morph presets fast."),
    ] = None

    def overrides(self, **options: object) -> dict[str, Any]:
        """Settings by dotted path: those of options, and `path=value` as after --set.

        Raises:
            ConfigError: One has no equals sign, or landmarks cannot be read.
        """
        options["landmarks"] = read_landmarks(self.landmark or (), self.landmarks)
        options["sampling.points_per_cell_edge"] = self.points_per_cell_edge
        options["sampling.fit"] = self.fit
        options["placement.source.up"] = options["placement.target.up"] = self.up
        options["placement.source.rotate"] = self.source_rotate
        options["placement.target.rotate"] = self.target_rotate
        chosen = {path: value for path, value in options.items() if value is not None}
        return chosen | parse_settings(self.settings or ())


@dataclass(frozen=True)
class ExecutionOptions:
    """How a run is computed on this machine."""

    resume: Annotated[bool, typer.Option("--resume", help="Continue an unfinished run.")] = False
    force: Annotated[bool, typer.Option("--force", help="Replace an existing result.")] = False
    device: DeviceOption = "auto"
    threads: Annotated[int, typer.Option(min=0, help="CPU threads; 0 uses every core.")] = 0
    quiet: QuietOption = False
    as_json: JsonOption = False


IdempotencyKeyOption = Annotated[
    str | None,
    typer.Option(metavar="KEY", help="Repeated commands with the same key take effect only once."),
]


@dataclass(frozen=True)
class SubmissionOptions:
    """How the service is to compute a job."""

    device: DeviceOption = "auto"
    priority: Annotated[
        int, typer.Option(help="1 to 1000; among your jobs, lower numbers start first.")
    ] = 100
    timeout: Annotated[
        float | None, typer.Option(help="Stop the job after this running time \\[s].")
    ] = None
    name: Annotated[str, typer.Option(help="A name of your choice.")] = ""
    reuse: Annotated[
        bool,
        typer.Option(
            "--reuse", help="Use the result of an identical job of yours, if there is one."
        ),
    ] = False
    states_every: Annotated[
        int, typer.Option(help="Keep the full state after every N frames, for morph fork.")
    ] = 0
    idempotency_key: IdempotencyKeyOption = None

    def request(self, config: ConfigOptions) -> dict[str, Any]:
        """What jobs and sweeps are requested with, but for their idempotency key."""
        return {
            "preset": config.preset,
            "frames": config.frames,
            "overrides": config.overrides(),
            "device": self.device,
            "priority": self.priority,
            "timeout_seconds": self.timeout,
            "name": self.name,
            "reuse": self.reuse,
            "states_every": self.states_every,
        }


@dataclass(frozen=True)
class ServiceOptions:
    """The service that a command asks, and how its answer is printed."""

    server: Annotated[
        str | None,
        typer.Option(
            envvar="MORPH_SERVER",
            help="Address of the service; default: http://127.0.0.1:8000.",
        ),
    ] = None
    key: KeyOption = None
    as_json: JsonOption = False

    def connect(self) -> MorphClient:
        """A client for the service; nothing is sent yet.

        Raises:
            ServiceError: The address or the key cannot be one.
        """
        from chamfer_morph.client import MorphClient

        return MorphClient(self.server, key=self.key)

    def print(self, document: object, text: str | Callable[[], None]) -> None:
        """Print an answer; see `print_result`."""
        print_result(document, text, as_json=self.as_json)
