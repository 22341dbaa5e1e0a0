"""Experiments behind the presets: what the text's parameters do, and why `fast` is what it is."""

from __future__ import annotations

from functools import partial
from typing import Any

from chamfer_morph.reproduction.experiments.experiment import Experiment, Row
from chamfer_morph.reproduction.experiments.paper_tables import shape_run
from chamfer_morph.reproduction.runs.run import Run

_experiment = partial(Experiment, in_all=False)
_bunny = partial(shape_run, "Sphere", "Bunny", "joint")
_fast = partial(_bunny, preset="fast")

_TEXT: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("Nothing", "", {}),
    (
        "s = .88, .90, .92 as the program has it",
        "smoothing",
        {"smoothing.values": (0.88, 0.90, 0.92), "smoothing.first_frames": (0, 10, 30)},
    ),
    (
        "The adjoint without (1 - s) from F to C, as the program has it",
        "adjoint",
        {"adjoint.drop_smoothing": True},
    ),
    ("Step .003 in place of .01", "step", {"optimizer.step": 0.003}),
)
"""What is changed in the preset `paper`: label, variant, overrides."""

SPEEDS = _experiment(
    name="speeds",
    title="Fastest particle of the first frames",
    metrics=("max_speed@0", "max_speed@1", "max_speed@2"),
    rows=(
        *(
            Row(
                label,
                (
                    _bunny(
                        variant="-".join(filter(None, ("first-paper", variant))),
                        preset="paper",
                        frames=3,
                        overrides=overrides,
                    ),
                ),
                "paper",
            )
            for label, variant, overrides in _TEXT
        ),
        Row("The program's settings", (_bunny(variant="first", frames=3),), "published"),
    ),
    remarks=(
        "Sphere → Bunny, joint, 3 points per cell edge, grid units per second. Rows of the preset "
        "paper name what is changed in it.",
    ),
)

_EXACT = {"adjoint.drop_smoothing": False}
_ALL = {"adjoint.carry_control": True, "adjoint.drop_drag": True}
_BEFORE: dict[str, Any] = {
    "optimizer.far_distance": 0.0,
    "material.drag": 0.5,
    "chamfer.reverse_smoothing": 2.0,
}
"""Settings of `published` that stood when control layers were chosen."""


def _layers(
    layers: int, passes: int, step: float, variant: str, more: dict[str, Any], *, edge: int = 3
) -> Run:
    """Sphere → Bunny with so many control layers a step, passes and an initial step."""
    name = f"layers{layers}-passes{passes}-step{step:g}"
    overrides = {
        **_BEFORE,
        "optimizer.layers_per_step": layers,
        "optimizer.passes": passes,
        "optimizer.step": step,
        **more,
    }
    return _fast(variant="-".join(filter(None, (name, variant))), edge=edge, overrides=overrides)


_ADJOINTS: dict[str, tuple[str, dict[str, Any]]] = {
    "exact": ("exact", _EXACT),
    "drop_smoothing": ("", {}),
    "all three departures": ("program-adjoint", _ALL),
}

LAYERS = _experiment(
    name="layers",
    title="Control layers per step",
    metrics=("two_sided", "cpu_seconds"),
    rows=tuple(
        Row(
            f"{layers} a step, passes {passes}, step {step:g}, adjoint {adjoint}",
            (_layers(layers, passes, step, *_ADJOINTS[adjoint], edge=2),),
        )
        for layers, passes, step, adjoint in (
            (9, 3, 0.01, "exact"),
            (9, 4, 0.003, "exact"),
            (1, 1, 0.01, "exact"),
            (1, 1, 0.01, "all three departures"),
            (1, 1, 0.01, "drop_smoothing"),
            (2, 1, 0.01, "drop_smoothing"),
            (3, 1, 0.01, "drop_smoothing"),
        )
    ),
    remarks=(
        "Sphere → Bunny, joint, 2 points per cell edge; preset fast, but for what a row names and "
        "drag, smoothing of the reverse term and steps that grow with the distance, which are as "
        "published.",
    ),
)

CALM = _experiment(
    name="calm",
    title="Calm motion",
    metrics=("two_sided", "t2s", "cpu_seconds"),
    rows=(
        *(
            Row(
                f"{layers} a step, drag {drag:g}",
                (_layers(layers, 1, 0.01, f"drag{drag:g}", {"material.drag": drag}),),
            )
            for layers, drag in ((2, 0.5), (2, 4.0), (1, 4.0))
        ),
        Row(
            "3 a step, 2 passes of step .006, drag 4, far_distance .5",
            (_fast(variant="sigma2", overrides={"chamfer.reverse_smoothing": 2.0}),),
        ),
    ),
    remarks=(
        "Sphere → Bunny, joint, 3 points per cell edge, reverse term smoothed as published. Rows "
        "without a number of passes have one, of step .01.",
    ),
)


def _sigma(target: str, sigma: float) -> Run:
    """Joint with the preset `fast` and a smoothing of the reverse term [cells]."""
    run = partial(shape_run, "Sphere", target, "joint")
    if not sigma:
        return run().quick()
    overrides = {"chamfer.reverse_smoothing": sigma}
    return run(preset="fast", variant=f"sigma{sigma:g}", overrides=overrides)


REVERSE = _experiment(
    name="reverse",
    title="Smoothing of the reverse term",
    metrics=("two_sided", "s2t", "t2s", "f1", "iou", "cpu_seconds"),
    rows=tuple(
        Row(f"{target}, sigma {sigma:g}", (_sigma(target, sigma),), target)
        for target in ("Bunny", "Duck", "Cow")
        for sigma in (2.0, 0.0)
    ),
    remarks=(
        "From the Sphere, joint with the preset fast, 3 points per cell edge; sigma in cells, 2 as "
        "published.",
    ),
)

DEFAULTS = {experiment.name: experiment for experiment in (SPEEDS, LAYERS, CALM, REVERSE)}
"""All of them by name."""
