"""B-spline weights between particles and grid nodes, cubic or quadratic (algorithm 2.1)."""

import taichi as ti


@ti.func
def weights(offset: float, width: ti.template()):
    """B-spline weights of the `width` nodes of a stencil along one axis; cubic 4, quadratic 3."""
    result = ti.Vector.zero(float, width)
    if ti.static(width == 4):
        f = offset - 1.0
        o = 1.0 - f
        result = ti.Vector(
            [o**3 / 6, f * f * (0.5 * f - 1) + 2 / 3, o * o * (0.5 * o - 1) + 2 / 3, f**3 / 6]
        )
    else:
        f = offset - 1.0
        result = ti.Vector([0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2])
    return result


@ti.func
def weight_derivatives(offset: float, width: ti.template()):
    """Derivatives of `weights` by the particle's position in cells."""
    result = ti.Vector.zero(float, width)
    if ti.static(width == 4):
        f = offset - 1.0
        o = 1.0 - f
        result = ti.Vector([-0.5 * o * o, f * (1.5 * f - 2), -o * (1.5 * o - 2), 0.5 * f * f])
    else:
        f = offset - 1.0
        result = ti.Vector([f - 0.5, -2 * f, f + 0.5])
    return result
