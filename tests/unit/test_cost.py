"""What a run needs, estimated before it begins."""

from pathlib import Path

import psutil
import pytest

from morph_engine.config import MorphConfig
from morph_engine.cost import estimate
from morph_engine.machine_memory import free_memory, total_memory
from morph_engine.presets import configure


def megabytes(config: MorphConfig, count: int = 1000, radius: float = 8.0) -> float:
    """Estimated memory of a run with as many particles as target points."""
    nodes = config.method.node_count(config, radius=radius, ratio=1.0)
    return estimate(count, count, 10, method=config.method.name, nodes=nodes).memory_mb


@pytest.mark.parametrize("method", ["physics", "joint"])
def test_memory_knows_the_grid(method: str) -> None:
    """As measured: 1989 MB with 160 cells and 174 000 particles, 702 MB with 100 and 43 000."""
    fine, coarse = (
        configure(overrides={"method": method, "grid.dx": 32 / cells, "time.dt": 0.0005})
        for cells in (160, 100)
    )
    assert megabytes(fine, 174_000) == pytest.approx(1989, rel=0.15)
    assert megabytes(coarse, 43_000) == pytest.approx(702, rel=0.15)


def test_memory_knows_the_grid_of_transport() -> None:
    """As measured: 504 MB with 240 cells along an axis, and few particles."""
    settings = {"method": "transport", "grid.half_extent": 120, "sampling.points_per_cell_edge": 1}
    assert megabytes(configure(overrides=settings), 1400) == pytest.approx(504, rel=0.15)


def test_the_grid_of_the_flow_holds_both_shapes() -> None:
    """As measured, with 4 particles per cell edge: 297, 343 and 423 MB for balls of such radii."""
    config = configure(overrides={"sampling.points_per_cell_edge": 4})
    for radius, seen in ((3, 297), (8, 343), (13, 423)):
        assert megabytes(config, 6500, radius) == pytest.approx(seen, rel=0.25)


def test_without_a_grid_its_spacing_does_not_matter() -> None:
    """Points alone take what points take."""
    fine, coarse = (configure(overrides={"method": "dco", "grid.dx": dx}) for dx in (0.5, 1.0))
    assert megabytes(fine) == megabytes(coarse)


def test_a_process_has_what_its_groups_are_given(tmp_path: Path) -> None:
    """The smallest limit of those around it, and what is left; no limit: the machine's memory."""
    machine = psutil.virtual_memory()
    assert total_memory(tmp_path) == machine.total
    membership = tmp_path / "proc/self/cgroup"
    membership.parent.mkdir(parents=True)
    membership.write_text("5:memory:/job\n0::/slice/service\n")
    service = tmp_path / "sys/fs/cgroup/slice/service"
    service.mkdir(parents=True)
    (service / "memory.max").write_text("max\n")
    (service / "memory.current").write_text("1000\n")
    assert total_memory(tmp_path) == machine.total
    (service.parent / "memory.max").write_text("5000\n")
    (service.parent / "memory.current").write_text("1000\n")
    assert total_memory(tmp_path) == 5000
    assert free_memory(tmp_path) == 4000
    (service.parent / "memory.stat").write_text("anon 700\ninactive_file 300\n")
    assert free_memory(tmp_path) == 4300
    older = tmp_path / "sys/fs/cgroup/memory/job"
    older.mkdir(parents=True)
    (older / "memory.limit_in_bytes").write_text("3000\n")
    (older / "memory.usage_in_bytes").write_text("4000\n")
    assert (total_memory(tmp_path), free_memory(tmp_path)) == (3000, 0)
