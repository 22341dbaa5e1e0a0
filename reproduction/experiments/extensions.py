"""Experiments that go past the paper: the method `transport`, beside the paper's own."""

from __future__ import annotations

from functools import partial
from typing import Any

from chamfer_morph.reproduction.experiments.experiment import Experiment, Row
from chamfer_morph.reproduction.experiments.paper_tables import (
    PAIR_NAMES,
    SEEDS,
    converged,
    rested,
    shape_run,
)
from chamfer_morph.reproduction.runs.run import Run

_extension = partial(Experiment, in_all=False)

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


transport: partial[Run] = partial(shape_run, method="transport", preset="fast")
"""A run of `transport` at its default settings, but for what is overridden."""


def _name(pair: tuple[str, str]) -> str:
    return " → ".join(pair)


TRANSPORT = _extension(
    name="transport",
    title="Transport against the paper's joint method",
    metrics=FILL_METRICS,
    rows=tuple(
        Row(f"{_name(pair)}, {method}", (run,), _name(pair))
        for pair in PAIRS
        for method, run in (("joint", shape_run(*pair, "joint")), ("transport", transport(*pair)))
    ),
    remarks=("3 points per cell edge; joint with the published settings, transport with its own.",),
)


def headline_runs(pair: tuple[str, str]) -> dict[str, Run]:
    """A run of each method that is compared on a pair, each at the settings it is best at."""
    return {
        "flow": shape_run(*pair, "flow", preset="fast"),
        "transport": transport(*pair),
        "joint": shape_run(*pair, "joint").quick(),
        "physics": shape_run(*pair, "physics").quick(),
        "DCO": rested(*pair),
        "DCD": rested(*pair, "dcd"),
    }


HEADLINE = _extension(
    name="headline",
    title="All methods, by points that none of them has seen",
    metrics=(
        "dense_t2s", "dense_floor", "dense_s2t", "dense_s2t_floor", "mesh_iou_level",
        "density_p05", "density_p95", "surface_mean",
    ),
    by_mesh=True,
    rows=tuple(
        Row(f"{_name(pair)}, {method}", (run,), _name(pair))
        for pair in PAIRS
        for method, run in headline_runs(pair).items()
    ),
    remarks=(
        "3 points per cell edge. flow, transport, joint and physics with the preset fast, DCO and "
        "DCD at rest: 1200 steps with epsilon 1e-8.",
        "t→s and s→t are root mean squares over random points of the target's volume; t→s has the "
        "floor of as many particles on a cubic lattice, s→t that of particles at random places "
        "inside the target. IoU is that of the particles' body, offset to the mesh's volume; "
        "density is taken over a lattice of random offset and turn.",
    ),
)  # fmt: skip

_HALF_SPACING = {"edge": 2, "variant": "dx05", "overrides": {"grid.dx": 0.5}}
_FINER: tuple[tuple[tuple[tuple[str, str], ...], str, str, Any], ...] = (
    (PAIRS, "4 per edge", "4 per edge", {"edge": 4}),
    (SELECTED_PAIRS, "5 per edge", "5 per edge", {"edge": 5}),
    (SELECTED_PAIRS, "2 per edge of half the length", "half the grid spacing", _HALF_SPACING),
)

FINER = _extension(
    name="finer",
    title="Transport at higher resolution",
    metrics=(*FILL_METRICS, "escaped", "outside_max"),
    rows=tuple(
        Row(f"{_name(pair)}, {label}", (transport(*pair, **options),), group)
        for pairs, label, group, options in _FINER
        for pair in pairs
    ),
    remarks=("Default settings throughout; distances at different h have different floors.",),
)

REPEATS = _extension(
    name="repeats",
    title="Transport with other seeds",
    metrics=FILL_METRICS,
    rows=tuple(
        Row(_name(pair), tuple(transport(*pair, seed=seed) for seed in SEEDS), _name(pair))
        for pair in SELECTED_PAIRS
    ),
    remarks=("Means and standard deviations over three seeds of jitter and plan.",),
)


PATH_METRICS = ("least_gap_ever", "det_f_min_ever", "det_f_max_ever", "max_move_ever")

MOTION = _extension(
    name="motion",
    title="How transport gets there",
    metrics=(*PATH_METRICS, "det_f_mean", "kinetic_energy", "max_speed", "correction"),
    rows=tuple(Row(_name(pair), (transport(*pair),), _name(pair)) for pair in PAIRS),
    remarks=(
        "The worst of all frames: the smallest distance of two particles (in h, at most 1), the "
        "least and the greatest det F, and the longest move of a particle in a frame (in dx). The "
        "last four are of the last frame.",
    ),
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

INGREDIENTS = _extension(
    name="ingredients",
    title="What each part of transport does",
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
)

OBJECTIVES = _extension(
    name="objectives",
    title="Is collapse peculiar to nearest neighbours?",
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
)  # fmt: skip

EXTENSIONS = {
    experiment.name: experiment
    for experiment in (HEADLINE, TRANSPORT, MOTION, FINER, REPEATS, INGREDIENTS, OBJECTIVES)
}
"""All of them by name."""
