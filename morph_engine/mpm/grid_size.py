"""How many nodes a grid has, known without the means to compute on it."""

PADDING = 2
"""Extra nodes on each side, which never hold mass or velocity."""


def nodes_per_axis(half_extent: float, dx: float) -> int:
    """Nodes along an axis, padding included, of a grid over [-half_extent, half_extent]^3."""
    return round(2 * half_extent / dx) + 1 + 2 * PADDING
