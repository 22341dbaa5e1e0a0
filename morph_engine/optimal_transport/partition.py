"""Points in compact groups of equal size, by recursive cuts in random directions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Groups:
    """A partition of points.

    Attributes:
        order: Indices of the points, group after group, shape [n].
        starts: Where each group starts in `order`, and n at the end, shape [count + 1].
    """

    order: Indices
    starts: Indices

    @property
    def sizes(self) -> Indices:
        """Number of points in each group, shape [count]."""
        return np.diff(self.starts)

    def __iter__(self) -> Iterator[Indices]:
        """Iterate over the indices of each group."""
        for first, last in zip(self.starts[:-1], self.starts[1:], strict=True):
            yield self.order[first:last]

    def means(self, points: Points) -> Points:
        """Mean of the points of each group, shape [count, 3]."""
        sums = np.add.reduceat(points[self.order], self.starts[:-1])
        return sums / self.sizes[:, None]


def split(points: Points, count: int, rng: np.random.Generator) -> Groups:
    """Partition points, shape [n, 3], into 1 to n groups whose sizes differ by one or two at most.

    Every group is cut in two by a plane of random direction until it is to be one group; where it
    is to become an odd number of groups, the plane divides it in that proportion.
    """
    order = np.arange(len(points))
    starts = np.array([0, len(points)])
    shares = np.array([count])
    while shares.max() > 1:
        sizes = np.diff(starts)
        group = np.repeat(np.arange(len(sizes)), sizes)
        direction = rng.normal(size=(len(sizes), 3))
        along = np.einsum("ij,ij->i", points[order], direction[group])
        order = order[np.lexsort((along, group))]
        left = shares // 2
        cuts = starts[:-1] + np.rint(sizes * (left / shares)).astype(int)
        divided = np.stack([left, shares - left], axis=1).ravel()
        begins = np.stack([starts[:-1], cuts], axis=1).ravel()
        keep = divided > 0
        starts, shares = np.append(begins[keep], len(points)), divided[keep]
    return Groups(order, starts)


def spread(points: Points, count: int, rng: np.random.Generator) -> Indices:
    """Choose 0 to n points, shape [n, 3]: of each of `count` groups the one nearest to its mean.

    Returns:
        Indices of the chosen points, shape [count].
    """
    if not count:
        return np.arange(0)
    groups = split(points, count, rng)
    apart = np.sum(
        (points[groups.order] - np.repeat(groups.means(points), groups.sizes, 0)) ** 2, 1
    )
    group = np.repeat(np.arange(count), groups.sizes)
    nearest_first = np.lexsort((apart, group))
    return groups.order[nearest_first[groups.starts[:-1]]]
