"""How little a body could be torn by any motion that ends in the same places.

    python -m benchmarks.least_d2min result.vtkhdf --sweeps 8000

D2min (`metrics.path.neighbor_metrics`) depends only on where particles begin and end, and is
quadratic in the ends. So it can be lowered directly, with no body, flow or material in between:
particles exchange their ends with others nearby while a temperature falls (simulated annealing,
Kirkpatrick et al. 1983). What is found bounds the least from above; more sweeps find less.
Printed on the way are D2min and the share of the 12 neighbours that are kept.
"""

import argparse
from pathlib import Path

import numpy as np
import scipy
import taichi as ti
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morph_engine import backend
from morph_engine.metrics.path import NEIGHBORS, neighbor_metrics
from morph_engine.results.trajectory import Trajectory

Points = NDArray[np.float64]

TEMPERATURES = (1.0, 0.2)
"""At the beginning and the end, of what an exchange adds to the sum over particles [h^2]."""

STEPS = 40
"""Temperatures in between; after them there is none."""

NEARBY = 18
"""Ends nearby that a particle may exchange its own with."""


def torn(start: Points, spacing: float) -> scipy.sparse.csr_array:
    """The matrix M of D2min: the sum over particles is the trace of y^T M y [h^2], shape [n, n].

    Args:
        start: Where particles begin [dx], shape [n, 3].
        spacing: Lattice spacing h [dx].
    """
    near = cKDTree(start).query(start, NEIGHBORS + 1)[1]
    basis = np.linalg.qr(start[near[:, 1:]] - start[near[:, :1]])[0]
    off_affine = np.eye(NEIGHBORS) - basis @ basis.transpose(0, 2, 1)
    difference = np.concatenate([-np.ones((NEIGHBORS, 1)), np.eye(NEIGHBORS)], axis=1)
    blocks = difference.T @ off_affine @ difference / (NEIGHBORS * spacing**2)
    pairs = np.repeat(near, near.shape[1], axis=1), np.tile(near, near.shape[1])
    entries = blocks.ravel(), tuple(index.ravel() for index in pairs)
    return scipy.sparse.csr_array(entries, (len(start),) * 2)


@ti.func
def entry(first: ti.template(), other: ti.template(), weight: ti.template(), i: int, j: int):
    """M_ij."""
    found = ti.f64(0.0)
    for k in range(first[i], first[i + 1]):
        if other[k] == j:
            found = weight[k]
    return found


@ti.kernel
def exchange(
    ends: ti.types.ndarray(ndim=2),
    nearby: ti.types.ndarray(ndim=2),
    held: ti.types.ndarray(),
    first: ti.types.ndarray(),
    other: ti.types.ndarray(),
    weight: ti.types.ndarray(),
    slope: ti.types.ndarray(ndim=2),
    temperature: ti.f64,
    tries: int,
):
    """Let pairs of particles exchange ends where that lowers the sum, or by chance.

    `held` tells which particle each end belongs to; `first`, `other` and `weight` are the rows of
    M, and `slope` is M y.
    """
    ti.loop_config(serialize=True)
    for _ in range(tries):
        here = ti.random(int) % ends.shape[0]
        here = ti.select(here < 0, here + ends.shape[0], here)
        there = nearby[here, ti.cast(ti.random(float) * NEARBY, int) % NEARBY]
        a, b = held[here], held[there]
        step = ti.Vector.zero(ti.f64, 3)
        along = ti.f64(0.0)
        for axis in ti.static(range(3)):
            step[axis] = ends[there, axis] - ends[here, axis]
            along += step[axis] * (slope[a, axis] - slope[b, axis])
        both = entry(first, other, weight, a, a) + entry(first, other, weight, b, b)
        both -= 2 * entry(first, other, weight, a, b)
        added = 2 * along + step.norm_sqr() * both
        if added <= 0 or ti.random(ti.f64) < ti.exp(-added / ti.max(temperature, 1e-9)):
            held[here], held[there] = b, a
            for k in range(first[a], first[a + 1]):
                for axis in ti.static(range(3)):
                    slope[other[k], axis] += weight[k] * step[axis]
            for k in range(first[b], first[b + 1]):
                for axis in ti.static(range(3)):
                    slope[other[k], axis] -= weight[k] * step[axis]


def annealed(start: Points, end: Points, spacing: float, sweeps: int) -> None:
    """Exchange ends while the temperature falls, and print what is found.

    Args:
        start: Where particles begin [dx], shape [n, 3].
        end: Where they end [dx], shape [n, 3].
        spacing: Lattice spacing h [dx].
        sweeps: Tries for each particle.
    """
    matrix = torn(start, spacing)
    nearby = cKDTree(end).query(end, NEARBY + 1)[1][:, 1:].astype(np.int32)
    held = np.arange(len(end), dtype=np.int32)
    rows = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32), matrix.data
    ends = end.copy()
    _tell("at first", start, ends, spacing)
    for temperature in (*np.geomspace(*TEMPERATURES, STEPS), 0.0):
        for _ in range(-(-sweeps // STEPS)):
            exchange(end, nearby, held, *rows, matrix @ ends, temperature, len(end))
            ends[held] = end
        _tell(f"{temperature:.2f} h²", start, ends, spacing)


def _tell(when: str, start: Points, ends: Points, spacing: float) -> None:
    found = neighbor_metrics(start, ends, spacing)
    print(f"{when}: D2min {found['d2_min']:.3f} h², kept {found['kept']:.3f}")


def main() -> None:
    """Read the command line and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.least_d2min")
    parser.add_argument("result", type=Path)
    parser.add_argument("--sweeps", type=int, default=4000, help="tries for each particle")
    arguments = parser.parse_args()
    with Trajectory(arguments.result) as result:
        start, end = (result.positions(frame).astype(float) for frame in (0, -1))
        spacing = result.config.spacing
    backend.start("cpu")
    annealed(start, end, spacing, arguments.sweeps)


if __name__ == "__main__":
    main()
