"""Experiments that go past the paper: the method `transport`, beside the paper's own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from chamfer_morph.reproduction.experiments.experiment import Experiment, Row
from chamfer_morph.reproduction.experiments.paper_tables import (
    PAIR_NAMES,
    SEEDS,
    converged,
    shape_run,
)
from chamfer_morph.reproduction.runs.run import Run

PAIRS = (*PAIR_NAMES, *(("Sphere", target) for target in ("Dragon", "Heart", "C", "E", "V")))
"""The paper's 20 pairs, and its sphere to the other shapes."""

SELECTED_PAIRS = (
    ("Sphere", "Bunny"), ("Sphere", "Teapot"), ("Teapot", "Cow"), ("Cow", "Duck"),
    ("Bunny", "Teapot"),
)  # fmt: skip
"""Volumes alike and unlike, thin parts and thick ones."""

FILL_METRICS = (
    "two_sided",
    "f1",
    "hausdorff",
    "iou",
    "rho_p05",
    "rho_p95",
    "rho_p99",
    "overlap_h10",
    "surface_mean",
)


def transport(
    source: str,
    target: str,
    *,
    edge: int = 3,
    variant: str = "",
    seed: int = SEEDS[0],
    overrides: Mapping[str, Any] | None = None,
) -> Run:
    """A run of `transport` at its default settings, but for what is overridden."""
    return shape_run(
        source,
        target,
        "transport",
        edge=edge,
        variant=variant,
        seed=seed,
        preset="fast",
        overrides=overrides,
    )


def _name(pair: tuple[str, str]) -> str:
    return " → ".join(pair)


TRANSPORT = Experiment(
    name="transport",
    title="Transport against the paper's joint method",
    origin="not in the paper",
    metrics=FILL_METRICS,
    rows=tuple(
        Row(f"{_name(pair)}, {method}", (run,), _name(pair))
        for pair in PAIRS
        for method, run in (("joint", shape_run(*pair, "joint")), ("transport", transport(*pair)))
    ),
    remarks=("3 points per cell edge; joint with the published settings, transport with its own.",),
    in_all=False,
)

FINER = Experiment(
    name="finer",
    title="Transport at higher resolution",
    origin="not in the paper",
    metrics=(*FILL_METRICS, "escaped", "outside_max"),
    rows=(
        *(
            Row(f"{_name(pair)}, 4 per edge", (transport(*pair, edge=4),), "4 per edge")
            for pair in PAIRS
        ),
        *(
            Row(f"{_name(pair)}, 5 per edge", (transport(*pair, edge=5),), "5 per edge")
            for pair in SELECTED_PAIRS
        ),
        *(
            Row(
                f"{_name(pair)}, 2 per edge of half the length",
                (transport(*pair, edge=2, variant="dx05", overrides={"grid.dx": 0.5}),),
                "half the grid spacing",
            )
            for pair in SELECTED_PAIRS
        ),
    ),
    remarks=("Default settings throughout; distances at different h have different floors.",),
    in_all=False,
)

REPEATS = Experiment(
    name="repeats",
    title="Transport with other seeds",
    origin="not in the paper",
    metrics=FILL_METRICS,
    rows=tuple(
        Row(_name(pair), tuple(transport(*pair, seed=seed) for seed in SEEDS), _name(pair))
        for pair in SELECTED_PAIRS
    ),
    remarks=("Means and standard deviations over three seeds of jitter and plan.",),
    in_all=False,
)


PATH_METRICS = ("least_gap_ever", "det_f_min_ever", "det_f_max_ever", "max_move_ever")

MOTION = Experiment(
    name="motion",
    title="How transport gets there",
    origin="not in the paper",
    metrics=(*PATH_METRICS, "det_f_mean", "kinetic_energy", "max_speed", "correction"),
    rows=tuple(Row(_name(pair), (transport(*pair),), _name(pair)) for pair in PAIRS),
    remarks=(
        "The worst of all frames: the smallest distance of two particles (in h, at most 1), the "
        "least and the greatest det F, and the farthest way of a particle in a frame (in dx). The "
        "last four are of the last frame.",
    ),
    in_all=False,
)

REMOVED_PARTS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("All of it", "", {}),
    ("Places drawn at random", "random", {"destinations": "random"}),
    ("Without exchanges", "sweeps0", {"sweeps": 0}),
    ("Without pressure", "soft", {"material.youngs_modulus": 1.0}),
    ("Without correction", "grid", {"correction": 0.0}),
    ("Without the grid", "straight", {"correction": 1000.0}),
    ("Without rest", "restless", {"rest": 0.0}),
)
"""Ingredients of `transport`, each left out once: label, variant, overrides."""

INGREDIENTS = Experiment(
    name="ingredients",
    title="What each part of transport does",
    origin="not in the paper",
    metrics=("two_sided", "iou", "rho_p05", "rho_p95", "overlap_h10", *PATH_METRICS),
    rows=tuple(
        Row(
            f"{_name(pair)}: {label.lower()}",
            (transport(*pair, variant=variant, overrides=overrides),),
            _name(pair),
        )
        for pair in SELECTED_PAIRS
        for label, variant, overrides in REMOVED_PARTS
    ),
    remarks=(
        "Each row leaves out one part. Without exchanges, the plan is that of compact groups; "
        "without correction, the grid alone moves particles; without the grid, every particle "
        "goes straight to its place.",
    ),
    in_all=False,
)

OBJECTIVES = Experiment(
    name="objectives",
    title="Is collapse peculiar to nearest neighbours?",
    origin="not in the paper",
    metrics=(
        "two_sided", "overlap_01", "overlap_h10", "many_to_one", "iou", "rho_p05", "rho_p95",
    ),
    rows=(
        Row("Chamfer (DCO), converged", (converged("dco"),)),
        Row("Density-aware Chamfer, converged", (converged("density_aware"),)),
        Row("Sliced Wasserstein, 3600 steps", (converged("swd"),)),
        Row("Sinkhorn divergence, 1800 steps", (converged("sinkhorn", frames=60),)),
        Row("Transport", (transport("Sphere", "Bunny"),)),
    ),
    remarks=(
        "Sphere → Bunny, 3 points per cell edge. The first four move points without physics; the "
        "first two match each to its nearest, the other two hand out the target's mass.",
    ),
    in_all=False,
)  # fmt: skip

_IN_ORDER = (TRANSPORT, MOTION, FINER, REPEATS, INGREDIENTS, OBJECTIVES)

EXTENSIONS = {experiment.name: experiment for experiment in _IN_ORDER}
"""All of them by name."""
