"""Matter that steers to given places: velocities before a time step, positions after it.

At the share e of its way particle p belongs at y_p = a_p + e (b_p - a_p), where a_p is where it
began and b_p its destination.
"""

import taichi as ti

LEAST_VOLUME, LARGEST_VOLUME = 0.5, 2.0
"""Change of volume beyond which matter does not press or pull any harder."""


@ti.func
def place(begin, destination, share: float):
    """Where a particle belongs after a share of its way."""
    return begin + share * (destination - begin)


@ti.kernel
def steer(
    x: ti.types.ndarray(),
    v: ti.types.ndarray(),
    F: ti.types.ndarray(),
    begin: ti.types.ndarray(),
    destination: ti.types.ndarray(),
    share: float,
    dt: float,
):
    """Give particles the velocity that takes them to their place in one step.

    Matter yields: of its deformation only the change of volume is kept, F = J^(1/3) I, so that it
    resists being compressed and not being kneaded.
    """
    for p in range(x.shape[0]):
        v[p] = (place(begin[p], destination[p], share) - x[p]) / dt
        J = ti.math.clamp(F[p].determinant(), LEAST_VOLUME, LARGEST_VOLUME)
        F[p] = J ** (1 / 3) * ti.Matrix.identity(float, 3)


@ti.kernel
def correct(
    x: ti.types.ndarray(),
    corrected: ti.types.ndarray(),
    begin: ti.types.ndarray(),
    destination: ti.types.ndarray(),
    share: float,
    limit: float,
):
    """Move particles the last bit to their place, which the grid is too coarse to do.

    No particle moves farther than `limit` [dx]; `corrected` gathers how far it moved.
    """
    for p in range(x.shape[0]):
        step = place(begin[p], destination[p], share) - x[p]
        length = step.norm()
        if length > limit:
            step *= limit / length
        x[p] += step
        corrected[p] += ti.min(length, limit)
