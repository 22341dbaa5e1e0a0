"""Elastic energies: first Piola stress P(A) and its differential (algorithm 2.2, 2.8, 4.5).

Both laws are written with the cofactor matrix, cof(A) = det(A) A^-T, which stays finite for a
singular A; whether an inverted element is acceptable is decided by the watchdog, not here.
"""

import taichi as ti

NEO_HOOKEAN = 0
FIXED_COROTATED = 1
SMALLEST_VOLUME_RATIO = 1e-6


@ti.func
def double_dot(a, b):
    """A:B, the sum of the products of all entries."""
    return (a * b).sum()


@ti.func
def cofactor(a):
    """cof(A) = d det(A) / dA; its rows are the cross products of the rows of A."""
    x, y, z = a[0, :], a[1, :], a[2, :]
    return ti.Matrix.rows([y.cross(z), z.cross(x), x.cross(y)])


@ti.func
def cofactor_differential(a, z):
    """Directional derivative of cof at A along Z."""
    a0, a1, a2 = a[0, :], a[1, :], a[2, :]
    z0, z1, z2 = z[0, :], z[1, :], z[2, :]
    return ti.Matrix.rows(
        [z1.cross(a2) + a1.cross(z2), z2.cross(a0) + a2.cross(z0), z0.cross(a1) + a0.cross(z1)]
    )


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
    step = 0.5 * (c / det - r)
    return r + step, step.norm_sqr()


@ti.func
def stress(a, r, lame_lambda: float, lame_mu: float, model: ti.template()):
    """First Piola stress P(A) [density * dx^2 / s^2] (algorithm 2.2, 2.8); R is used by one law."""
    cof = cofactor(a)
    volume_ratio = (a[0, :] * cof[0, :]).sum()
    p = a
    if ti.static(model == FIXED_COROTATED):
        p = 2 * lame_mu * (a - r) + lame_lambda * (volume_ratio - 1) * cof
    else:
        j = ti.max(volume_ratio, SMALLEST_VOLUME_RATIO)
        p = lame_mu * a + (lame_lambda * ti.log(j) - lame_mu) / j * cof
    return p


@ti.func
def stress_differential(a, r, z, lame_lambda: float, lame_mu: float, model: ti.template()):
    """dP(A)[Z], the energy Hessian applied to Z; symmetric, so its own adjoint (algorithm 4.5)."""
    cof = cofactor(a)
    volume_ratio = (a[0, :] * cof[0, :]).sum()
    result = z
    if ti.static(model == FIXED_COROTATED):
        result = (
            2 * lame_mu * (z - _rotation_differential(a, r, z))
            + lame_lambda * double_dot(cof, z) * cof
            + lame_lambda * (volume_ratio - 1) * cofactor_differential(a, z)
        )
    else:
        j = ti.max(volume_ratio, SMALLEST_VOLUME_RATIO)
        b = cof / j
        result = (
            lame_mu * z
            + (lame_mu - lame_lambda * ti.log(j)) * (b @ z.transpose() @ b)
            + lame_lambda * double_dot(b, z) * b
        )
    return result


@ti.func
def _rotation_differential(a, r, z):
    """dR = R [omega]x with (tr(S) I - S) omega = axial(R^T Z - Z^T R), S = R^T A."""
    s = r.transpose() @ a
    t = r.transpose() @ z
    m = s.trace() * ti.Matrix.identity(float, 3) - 0.5 * (s + s.transpose())
    det = m.determinant()
    if ti.abs(det) < 1e-6:
        m += 1e-4 * ti.Matrix.identity(float, 3)
        det = m.determinant()
    axial = ti.Vector([t[2, 1] - t[1, 2], t[0, 2] - t[2, 0], t[1, 0] - t[0, 1]])
    w = cofactor(m) @ axial / det
    return r @ ti.Matrix([[0, -w.z, w.y], [w.z, 0, -w.x], [-w.y, w.x, 0]])
