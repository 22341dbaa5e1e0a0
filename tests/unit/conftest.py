"""What unit tests share: a small result that no simulation made."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from morph_engine.geometry.placement import Placement
from morph_engine.geometry.sampling import Similarity
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import write_result

FRAMES = 3
TO_GRID = Similarity(0.5, (10.0, -20.0, 30.0)).inverse()


def ball(radius: float, spacing: float) -> np.ndarray:
    """The lattice points in a ball about the origin, shape [n, 3], float32."""
    reach = np.arange(-np.ceil(radius / spacing), np.ceil(radius / spacing) + 1) * spacing
    points = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    return points[np.linalg.norm(points, axis=1) < radius].astype(np.float32)


@pytest.fixture(scope="session")
def lattice_ball() -> Callable[[float, float], np.ndarray]:
    """Makes the lattice points in a ball of a radius, at a spacing."""
    return ball


@pytest.fixture(scope="session")
def small_result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball of 1021 particles that becomes an egg in three frames, with det F and one metric."""
    source = ball(3.1, 0.5)
    config = configure("fast", {"sampling.points_per_cell_edge": 2, "frames": FRAMES})
    egg = source * np.float32([1, 1.3, 1])
    record = RunRecord(
        config=config,
        source=source,
        target=egg,
        source_points=source,
        target_points=egg,
        placement=Placement(source=TO_GRID, target=TO_GRID),
    )
    path = tmp_path_factory.mktemp("result") / "egg.vtkhdf"
    with Spool.create(path, record) as spool:
        for frame in range(FRAMES):
            stretch = 1 + 0.1 * (frame + 1)
            det_f = np.full(len(source), stretch, np.float32)
            positions = source * np.float32([1, stretch, 1])
            spool.append(frame, positions, {"s2t": 1 / (frame + 3)}, (), det_f)
        write_result(spool, status="complete")
        spool.remove()
    return path
