"""CPU and wall time of competing actions, measured in turns so that both meet the same machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median

WARM_UPS = 2


@dataclass(frozen=True)
class Cost:
    """What an action cost: CPU time summed over threads [s] and wall-clock time [s]."""

    cpu: float
    wall: float


def cost_of(action: Callable[[], object]) -> Cost:
    """Run an action once in this process and measure it."""
    cpu, wall = time.process_time(), time.perf_counter()
    action()
    return Cost(time.process_time() - cpu, time.perf_counter() - wall)


def interleaved(
    actions: Mapping[str, Callable[[], object]],
    repeats: int,
    *,
    before_each: Callable[[], object] = lambda: None,
) -> dict[str, Cost]:
    """Median cost of each action over rounds in which every action runs once.

    Two rounds before them are not counted: they compile and fill caches. `before_each` runs,
    untimed, before every action.
    """
    costs: dict[str, list[Cost]] = {name: [] for name in actions}
    for _ in range(WARM_UPS + repeats):
        for name, action in actions.items():
            before_each()
            costs[name].append(cost_of(action))
    return {
        name: Cost(median(c.cpu for c in all_[WARM_UPS:]), median(c.wall for c in all_[WARM_UPS:]))
        for name, all_ in costs.items()
    }
