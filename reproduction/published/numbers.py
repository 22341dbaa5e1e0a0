"""What has been published: every number of the paper's tables, and of the published program.

Metrics have the names and units of `morph_engine.metrics`; shares are 0 to 1. Numbers of the 2D
experiment stand with it, in `chamfer_morph.reproduction.planar`.
"""

from __future__ import annotations

from collections.abc import Sequence

Numbers = dict[str, float]

CHAMFER = ("s2t", "t2s", "two_sided")
TARGETS = ("Bunny", "Duck", "Cow", "Teapot")
SHAPES = ("Sphere", *TARGETS)


def _rows(metrics: Sequence[str], rows: dict[str, Sequence[float]]) -> dict[str, Numbers]:
    return {label: dict(zip(metrics, values, strict=True)) for label, values in rows.items()}


_REGULARISERS = _rows(
    CHAMFER,
    {
        "DCO": (0.220, 0.182, 0.286),
        "DCO + repulsion 0.01": (0.232, 0.182, 0.295),
        "DCO + repulsion 0.1": (0.250, 0.182, 0.309),
        "DCO + repulsion, smoothness": (0.240, 0.181, 0.301),
        "DCO + repulsion, smoothness, volume": (0.240, 0.194, 0.309),
        "DCD": (0.197, 0.182, 0.268),
        "Physics": (0.130, 0.174, 0.217),
    },
)

_GENERALISATION = _rows(
    ("DCO", "DCD", "Physics"),
    {
        "Bunny": (0.286, 0.268, 0.217),
        "Duck": (0.744, 0.740, 0.247),
        "Cow": (0.449, 0.436, 0.228),
        "Teapot": (0.209, 0.199, 0.230),
    },
)

_SPHERE = _rows(
    (*CHAMFER, "hausdorff", "f1"),
    {
        "Bunny, physics": (0.181, 0.174, 0.251, 0.963, 0.757),
        "Bunny, joint": (0.157, 0.163, 0.226, 0.580, 0.851),
        "Duck, physics": (0.184, 0.214, 0.282, 0.930, 0.626),
        "Duck, joint": (0.173, 0.215, 0.276, 0.646, 0.643),
        "Cow, physics": (0.178, 0.185, 0.257, 0.715, 0.733),
        "Cow, joint": (0.167, 0.167, 0.236, 0.672, 0.819),
        "Teapot, physics": (0.180, 0.190, 0.262, 0.954, 0.688),
        "Teapot, joint": (0.148, 0.181, 0.234, 0.842, 0.810),
    },
)

# (physics, joint) for each target but the source itself, in the order of SHAPES
_PAIRS_TWO_SIDED = {
    "Sphere": ((0.251, 0.226), (0.282, 0.276), (0.257, 0.236), (0.262, 0.234)),
    "Bunny": ((0.295, 0.250), (0.297, 0.288), (0.256, 0.240), (0.286, 0.259)),
    "Duck": ((0.293, 0.296), (0.283, 0.276), (0.280, 0.295), (0.326, 0.309)),
    "Cow": ((0.291, 0.315), (0.275, 0.252), (0.425, 0.284), (0.318, 0.293)),
    "Teapot": ((0.226, 0.213), (0.257, 0.252), (0.355, 0.312), (0.237, 0.259)),
}
_PAIRS_S2T = {
    "Sphere": ((0.181, 0.157), (0.184, 0.173), (0.178, 0.167), (0.180, 0.148)),
    "Bunny": ((0.199, 0.159), (0.186, 0.167), (0.178, 0.159), (0.187, 0.150)),
    "Duck": ((0.181, 0.168), (0.183, 0.178), (0.184, 0.176), (0.190, 0.172)),
    "Cow": ((0.186, 0.167), (0.188, 0.156), (0.325, 0.168), (0.193, 0.161)),
    "Teapot": ((0.176, 0.146), (0.178, 0.165), (0.273, 0.176), (0.178, 0.169)),
}


def _pairs() -> dict[str, Numbers]:
    cells: dict[str, Numbers] = {}
    for source in SHAPES:
        targets = [target for target in SHAPES if target != source]
        for target, two_sided, s2t in zip(
            targets, _PAIRS_TWO_SIDED[source], _PAIRS_S2T[source], strict=True
        ):
            for column, method in enumerate(("physics", "joint")):
                cells[f"{source} → {target}, {method}"] = {
                    "two_sided": two_sided[column],
                    "s2t": s2t[column],
                }
    return cells


_DRAGON = _rows(
    (*CHAMFER, "hausdorff", "f1"),
    {
        "DCO, 3 per edge": (0.609, 0.255, 0.660, 2.695, 0.466),
        "DCD, 3 per edge": (0.608, 0.255, 0.659, 2.849, 0.463),
        "Physics, 3 per edge": (0.190, 0.246, 0.311, 3.202, 0.532),
        "Joint, 3 per edge": (0.160, 0.296, 0.336, 3.251, 0.493),
        "Joint, 4 per edge, native settings": (0.089, 0.087, 0.124, 0.780, 0.792),
    },
)

_ABLATION = _rows(
    CHAMFER,
    {
        "Full method": (0.157, 0.163, 0.226),
        "Fixed w_rev = 1": (0.158, 0.176, 0.237),
        "Fixed w_rev = 0.5": (0.158, 0.182, 0.241),
        "Clamp κ = 1": (0.162, 0.184, 0.245),
        "Clamp κ = 5": (0.156, 0.179, 0.237),
        "Decay at 15": (0.158, 0.179, 0.239),
        "Decay at 25": (0.158, 0.180, 0.240),
    },
)

PAPER: dict[str, dict[str, Numbers]] = {
    "regularisers": _REGULARISERS,
    "shapes": {
        f"{target}, {method}": {"two_sided": value}
        for target, row in _GENERALISATION.items()
        for method, value in row.items()
    },
    "sphere": _SPHERE,
    "pairs": _pairs(),
    "dragon": _DRAGON,
    "ablation": _ABLATION,
    "overlap": {
        "DCD, 3 per edge": {"overlap_01": 0.165},
        "DCD, 4 per edge": {"overlap_01": 0.165},
        "Joint, 3 per edge": {"overlap_01": 0.0},
    },
}
"""Printed numbers: experiment, row, metric."""

CLAIMS = {
    "pairs_two_sided": 16,
    "pairs_s2t": 20,
    "sphere_two_sided": 4,
    "sphere_s2t": 4,
    "sphere_mean_s2t_change": -0.108,
    "shapes_dco_worse": 3,
    "regularisers_worse": 4,
    "dragon_gain": 2.5,
}
"""What the paper concludes, as numbers."""


_FULL = (
    *CHAMFER, "hausdorff", "f1", "iou", "cover", "spill",
    "rho_p05", "rho_p50", "rho_p95", "rho_p99", "overlap_h10",
)  # fmt: skip

PROGRAM: dict[str, Numbers] = _rows(
    _FULL,
    {
        "sphere-bunny-physics": (
            0.1713, 0.1735, 0.2438, 0.9633, 0.7572, 0.9186, 0.9546, 0.0394,
            0.5696, 1.023, 1.6002, 2.5197, 0.0,
        ),
        "sphere-bunny-joint": (
            0.1397, 0.159, 0.2117, 0.6051, 0.8525, 0.9123, 0.9223, 0.0118,
            0.5026, 0.8549, 2.2116, 3.8962, 0.0,
        ),
        "sphere-bunny-joint-older": (
            0.1382, 0.1581, 0.21, 0.6631, 0.8553, 0.9139, 0.9241, 0.0118,
            0.4544, 0.865, 2.2883, 3.4709, 0.0,
        ),
        "sphere-bunny-joint-chain": (
            0.1529, 0.1673, 0.2266, 0.6576, 0.816, 0.9111, 0.9227, 0.0136,
            0.5435, 0.8722, 2.2488, 3.8272, 0.0,
        ),
        "sphere-duck-physics": (
            0.172, 0.2103, 0.2717, 0.9298, 0.6257, 0.8513, 0.8835, 0.041,
            0.5257, 0.695, 1.217, 4.8948, 0.1708,
        ),
        "sphere-duck-joint": (
            0.1581, 0.2201, 0.271, 0.8046, 0.6373, 0.7931, 0.801, 0.0123,
            0.3286, 0.5635, 2.9577, 7.5506, 0.0258,
        ),
        "sphere-cow-joint": (
            0.1488, 0.1654, 0.2225, 0.6491, 0.8217, 0.8986, 0.9079, 0.0113,
            0.4124, 0.7014, 3.3252, 5.1359, 0.0,
        ),
        "sphere-teapot-physics": (
            0.1716, 0.1902, 0.2561, 0.9542, 0.6883, 0.9265, 0.953, 0.0291,
            0.7248, 0.8957, 1.7902, 2.6517, 0.0,
        ),
        "sphere-teapot-joint": (
            0.1339, 0.1743, 0.2198, 0.7999, 0.8102, 0.9083, 0.9188, 0.0123,
            0.5805, 0.9349, 1.7674, 2.2024, 0.0,
        ),
        "bunny-sphere-joint": (
            0.1424, 0.1838, 0.2325, 0.6215, 0.7772, 0.9078, 0.9151, 0.0087,
            0.6374, 0.9394, 1.7033, 3.2779, 0.0,
        ),
        "bunny-cow-joint": (
            0.1382, 0.1572, 0.2094, 0.5935, 0.8592, 0.9084, 0.9189, 0.0124,
            0.5841, 0.9292, 1.8998, 3.0514, 0.0,
        ),
        "bunny-duck-joint": (
            0.1533, 0.2299, 0.2763, 0.9093, 0.6229, 0.7653, 0.772, 0.0113,
            0.3623, 0.6259, 2.9435, 5.7185, 0.0281,
        ),
        "bunny-teapot-joint": (
            0.136, 0.2079, 0.2484, 0.7149, 0.7063, 0.8361, 0.8433, 0.0101,
            0.5425, 0.8205, 2.1531, 4.4097, 0.0,
        ),
    },
) | _rows(
    # algorithm 8.2: the published DCO and DCD scripts' settings, repeated independently
    (*CHAMFER, "hausdorff", "f1", "overlap_01"),
    {
        "sphere-bunny-dco-n4": (0.2197, 0.1812, 0.2848, 1.618, 0.786, 0.0),
        "sphere-duck-dco-n4": (0.6662, 0.3295, 0.7432, 2.79, 0.472, 0.0),
        "sphere-cow-dco-n4": (0.3896, 0.2234, 0.4491, 1.37, 0.629, 0.0),
        "sphere-teapot-dco-n4": (0.1223, 0.1700, 0.2094, 2.18, 0.872, 0.0),
        "sphere-bunny-dcd-n4": (0.1967, 0.1825, 0.2683, 1.88, 0.818, 0.0),
        "sphere-bunny-dco": (0.068, 0.209, 0.220, 1.456, 0.836, 0.122),
        "sphere-bunny-dco-eps8": (0.042, 0.196, 0.200, 1.364, 0.845, 0.515),
    },
)  # fmt: skip
"""What the published program yields by run id: its own output at frame 39 for `physics` and
`joint`, an independent repetition with its settings for `dco` and `dcd` (algorithm 8.2, 9.2)."""
