"""Rigid motions in space: 4x4 matrices, batched.

Elements have shape ``(..., 4, 4)``, tangent vectors ``(..., 6)`` with the rotation first:
``(theta_x, theta_y, theta_z, x, y, z)`` [rad, m], all float64.
Perturbations are on the right: ``T.retract(d) = T @ exp(d)``. Composition is ``@``.

References
----------
.. [1] T. D. Barfoot, "State Estimation for Robotics", 2017, section 7.1 (the closed form of the Q block, eq. 7.86).
.. [2] J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, appendix D.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from heliograph import _core
from heliograph.arrays import Array, as_batch, broadcast, match
from heliograph.lie import _batch, _series, so3

__all__ = [
    "act",
    "adjoint",
    "compose",
    "exp",
    "from_rotation_translation",
    "hat",
    "identity",
    "inverse",
    "local",
    "log",
    "retract",
    "right_jacobian",
    "right_jacobian_inverse",
]


def identity(batch: tuple[int, ...] = ()) -> Array:
    """Return identity motions, (*batch, 4, 4)."""
    return np.tile(np.eye(4), (*batch, 1, 1))


def from_rotation_translation(R: ArrayLike, t: ArrayLike) -> Array:
    """Return motions from rotations (..., 3, 3) and translations (..., 3) [m], broadcast."""
    r, v = as_batch("R", R, (3, 3)), as_batch("t", t, (3,))
    batch = broadcast("R and t", r.shape[:-2], v.shape[:-1])
    return _from_parts(r, v, batch)


def _from_parts(R: Array, t: Array, batch: tuple[int, ...]) -> Array:
    out = np.zeros((*batch, 4, 4))
    out[..., :3, :3] = R
    out[..., :3, 3] = t
    out[..., 3, 3] = 1.0
    return out


def hat(xi: ArrayLike) -> Array:
    """Return the 4x4 matrix of a tangent vector, (..., 4, 4) from (..., 6)."""
    v = as_batch("xi", xi, (6,))
    out = np.zeros((*v.shape[:-1], 4, 4))
    out[..., :3, :3] = so3.hat(v[..., :3])
    out[..., :3, 3] = v[..., 3:]
    return out


def exp(xi: ArrayLike) -> Array:
    """Return the motion of a constant twist over unit time, (..., 4, 4) from (..., 6) ([2]_ eq. 172)."""
    v = as_batch("xi", xi, (6,))
    if v.ndim > 1:
        return _batch.each(_core.se3_exp, v, 1, (4, 4))
    phi, rho = v[..., :3], v[..., 3:]
    t = (so3.left_jacobian(phi) @ rho[..., None])[..., 0]
    return _from_parts(so3.exp(phi), t, ())


def log(T: ArrayLike) -> Array:
    """Return the tangent vector with a rotation of length in [0, pi], (..., 6) from (..., 4, 4) ([2]_ eq. 173)."""
    m = as_batch("T", T, (4, 4))
    if m.ndim > 2:
        return _batch.each(_core.se3_log, m, 2, (6,))
    phi = so3.log(m[..., :3, :3])
    rho = so3.left_jacobian_inverse(phi) @ m[..., :3, 3:]
    return np.concatenate([phi, rho[..., 0]], axis=-1)


def compose(T_a_b: ArrayLike, T_b_c: ArrayLike) -> Array:
    """Return ``T_a_c = T_a_b @ T_b_c``."""
    a, b = as_batch("T_a_b", T_a_b, (4, 4)), as_batch("T_b_c", T_b_c, (4, 4))
    if a.shape != b.shape:
        match("T_a_b and T_b_c", a.shape, b.shape)
    if a.ndim > 2 and a.shape == b.shape:
        return _batch.each_pair(_core.se3_compose, a, b)
    return np.asarray(a @ b)


def inverse(T: ArrayLike) -> Array:
    """Return ``T_b_a`` from ``T_a_b``, (..., 4, 4)."""
    m = as_batch("T", T, (4, 4))
    if m.ndim > 2:
        return _batch.each(_core.se3_inverse, m, 2, (4, 4))
    R_b_a = np.swapaxes(m[..., :3, :3], -1, -2)
    return _from_parts(R_b_a, -(R_b_a @ m[..., :3, 3:])[..., 0], m.shape[:-2])


def act(T: ArrayLike, points: ArrayLike) -> Array:
    """Return ``p_a = T_a_b @ p_b`` for points (..., 3).

    One motion acts on any number of points; a batch of motions acts element by element, broadcast. Single-precision
    points give a double-precision result.
    """
    m, p = as_batch("T", T, (4, 4)), as_batch("points", points, (3,))
    if m.ndim == 2:
        return np.asarray(p @ m[:3, :3].T + m[:3, 3], dtype=np.float64)
    match("T and points", m.shape[:-2], p.shape[:-1])
    return np.asarray((m[..., :3, :3] @ p[..., None])[..., 0] + m[..., :3, 3], dtype=np.float64)


def _block_lower(rotation: Array, coupling: Array) -> Array:
    """Return ``[[rotation, 0], [coupling, rotation]]``, (..., 6, 6)."""
    out = np.zeros((*coupling.shape[:-2], 6, 6))
    out[..., :3, :3] = rotation
    out[..., 3:, 3:] = rotation
    out[..., 3:, :3] = coupling
    return out


def adjoint(T: ArrayLike) -> Array:
    """Return Ad with ``T exp(d) = exp(Ad d) T``, (..., 6, 6), rotation first ([2]_ eq. 175)."""
    m = as_batch("T", T, (4, 4))
    if m.ndim > 2:
        return _batch.each(_core.se3_adjoint, m, 2, (6, 6))
    R = m[..., :3, :3]
    return _block_lower(R, so3.hat(m[..., :3, 3]) @ R)


def _coupling(phi: Array, rho: Array) -> Array:
    """Return the Q block of the left Jacobian, (..., 3, 3) ([1]_ eq. 7.86)."""
    theta2 = np.einsum("...i,...i->...", phi, phi)
    c3, c4, c5 = (
        np.asarray(f(theta2))[..., None, None]
        for f in (_series.cubic_defect, _series.quartic_defect, _series.quintic_defect)
    )
    K, P = so3.hat(phi), so3.hat(rho)
    KP, PK = K @ P, P @ K
    KPK = KP @ K
    KKP, PKK = K @ KP, PK @ K
    total = 0.5 * P + c3 * (KP + PK + KPK) + c4 * (KKP + PKK - 3.0 * KPK) + c5 * (KPK @ K + K @ KPK)
    return np.asarray(total, dtype=np.float64)


def right_jacobian(xi: ArrayLike) -> Array:
    """Return Jr with ``exp(xi + d) = exp(xi) exp(Jr d)`` to first order, (..., 6, 6)."""
    v = as_batch("xi", xi, (6,))
    if v.ndim > 1:
        return _batch.each(_core.se3_right_jacobian, v, 1, (6, 6))
    phi, rho = v[..., :3], v[..., 3:]
    return _block_lower(so3.right_jacobian(phi), _coupling(-phi, -rho))


def right_jacobian_inverse(xi: ArrayLike) -> Array:
    """Return the inverse of `right_jacobian`, (..., 6, 6); singular at a full turn."""
    v = as_batch("xi", xi, (6,))
    if v.ndim > 1:
        return _batch.each(_core.se3_right_jacobian_inverse, v, 1, (6, 6))
    phi, rho = v[..., :3], v[..., 3:]
    inverse_rotation = so3.right_jacobian_inverse(phi)
    return _block_lower(inverse_rotation, -inverse_rotation @ _coupling(-phi, -rho) @ inverse_rotation)


def retract(T: ArrayLike, d: ArrayLike) -> Array:
    """Return ``T @ exp(d)``."""
    return compose(as_batch("T", T, (4, 4)), exp(as_batch("d", d, (6,))))


def local(T_a: ArrayLike, T_b: ArrayLike) -> Array:
    """Return the d with ``retract(T_a, d) = T_b``, that is ``log(inverse(T_a) @ T_b)``, (..., 6)."""
    return log(compose(inverse(as_batch("T_a", T_a, (4, 4))), as_batch("T_b", T_b, (4, 4))))
