"""Elastic laws: Kirchhoff stress P(A) A^T, which is what moves the grid, and its adjoint.

The cofactor matrix, cof(A) = det(A) A^-T, stands for the inverse: it stays finite for a singular A.
Whether an inverted element is acceptable is decided by the watchdog, not here.
"""

import taichi as ti

NEO_HOOKEAN = 0
FIXED_COROTATED = 1
MODELS = {"neo_hookean": NEO_HOOKEAN, "fixed_corotated": FIXED_COROTATED}
SMALLEST_VOLUME_RATIO = 1e-6


@ti.func
def cofactor(a):
    """cof(A) = d det(A) / dA; its rows are the cross products of the rows of A."""
    x, y, z = a[0, :], a[1, :], a[2, :]
    return ti.Matrix.rows([y.cross(z), z.cross(x), x.cross(y)])


@ti.func
def rotation(a):
    """Rotation of the polar decomposition A = R S, by Newton's iteration; needs det A > 0."""
    r = a
    change = 1.0
    iteration = 0
    while change > 1e-8 and iteration < 20:
        r, change = _newton_step(r)
        iteration += 1
    # Convergence is quadratic: one more step turns 1e-4 into rounding error.
    r, change = _newton_step(r)
    return r


@ti.func
def _newton_step(r):
    c = cofactor(r)
    det = (r[0, :] * c[0, :]).sum()
    if ti.abs(det) < 1e-12:
        det = 1e-12
    step = (0.5 / det) * c - 0.5 * r
    return r + step, step.norm_sqr()


@ti.func
def kirchhoff_stress(a, r, lame_lambda: float, lame_mu: float, model: ti.template()):
    """Kirchhoff stress T(A) = P(A) A^T [density * dx^2 / s^2] (algorithm 2.2, 2.8).

    The fixed corotated law is written with the left stretch V = A R^T:
    T = 2 mu (V^2 - V) + lambda J (J - 1) I.
    """
    j = a.determinant()
    result = a
    if ti.static(model == FIXED_COROTATED):
        stretch = a @ r.transpose()
        result = 2 * lame_mu * (stretch @ stretch - stretch)
        result += _isotropic(lame_lambda * j * (j - 1))
    else:
        j = ti.max(j, SMALLEST_VOLUME_RATIO)
        result = lame_mu * (a @ a.transpose()) + _isotropic(lame_lambda * ti.log(j) - lame_mu)
    return result


@ti.func
def kirchhoff_stress_adjoint(a, r, t_bar, lame_lambda: float, lame_mu: float, model: ti.template()):
    """Gradient of T(A) : T_bar by A; with P_bar = T_bar A it is T_bar^T P + Hpsi(A)[P_bar].

    For the fixed corotated law dR = [omega]x R, where (tr(V) I - V) omega is the axial vector of
    T_bar V (algorithm 4.4, 4.5).
    """
    cof = cofactor(a)
    j = (a[0, :] * cof[0, :]).sum()
    symmetric = t_bar + t_bar.transpose()
    result = a
    if ti.static(model == FIXED_COROTATED):
        skew = _skew(_angular_velocity(a @ r.transpose(), t_bar))
        result = 2 * lame_mu * (symmetric @ a - (t_bar.transpose() + skew) @ r)
        result += lame_lambda * (2 * j - 1) * t_bar.trace() * cof
    else:
        factor = lame_lambda * t_bar.trace() / ti.max(j, SMALLEST_VOLUME_RATIO)
        result = lame_mu * (symmetric @ a) + factor * cof
    return result


@ti.func
def _isotropic(pressure: float):
    return ti.Matrix([[pressure, 0, 0], [0, pressure, 0], [0, 0, pressure]])


@ti.func
def _skew(w):
    """[w]x, the matrix of y -> w x y."""
    return ti.Matrix([[0, -w.z, w.y], [w.z, 0, -w.x], [-w.y, w.x, 0]])


@ti.func
def _angular_velocity(stretch, t):
    """The omega with (tr(V) I - V) omega = axial(T V - V T^T)."""
    m = stretch.trace() * ti.Matrix.identity(float, 3) - 0.5 * (stretch + stretch.transpose())
    m += ti.select(ti.abs(m.determinant()) < 1e-6, 1e-4, 0.0) * ti.Matrix.identity(float, 3)
    n = t @ stretch
    axial = ti.Vector([n[2, 1] - n[1, 2], n[0, 2] - n[2, 0], n[1, 0] - n[0, 1]])
    return cofactor(m) @ axial / m.determinant()
