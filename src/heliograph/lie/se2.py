"""Rigid motions in the plane: 3x3 matrices, batched.

Elements have shape ``(..., 3, 3)``, tangent vectors ``(..., 3)`` with the rotation first: ``(theta, x, y)`` [rad, m],
all float64. Perturbations are on the right.

References
----------
.. [1] J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, appendix C (there
   the rotation comes last).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from heliograph import _core
from heliograph.arrays import Array, as_batch, broadcast, match
from heliograph.lie import _batch, _series, so2

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
    """Return identity motions, (*batch, 3, 3)."""
    return np.tile(np.eye(3), (*batch, 1, 1))


def from_rotation_translation(R: ArrayLike, t: ArrayLike) -> Array:
    """Return motions from rotations (..., 2, 2) and translations (..., 2) [m], broadcast."""
    r, v = as_batch("R", R, (2, 2)), as_batch("t", t, (2,))
    batch = broadcast("R and t", r.shape[:-2], v.shape[:-1])
    return _from_parts(r, v, batch)


def _from_parts(R: Array, t: Array, batch: tuple[int, ...]) -> Array:
    out = np.zeros((*batch, 3, 3))
    out[..., :2, :2] = R
    out[..., :2, 2] = t
    out[..., 2, 2] = 1.0
    return out


def hat(xi: ArrayLike) -> Array:
    """Return the 3x3 matrix of a tangent vector, (..., 3, 3) from (..., 3)."""
    v = as_batch("xi", xi, (3,))
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., :2, :2] = so2.hat(v[..., :1])
    out[..., :2, 2] = v[..., 1:]
    return out


def _scaled_rotation(cosine: Array, sine: Array) -> Array:
    """Return ``[[c, -s], [s, c]]``, (..., 2, 2)."""
    return np.stack([np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)], axis=-2)


def exp(xi: ArrayLike) -> Array:
    """Return the motion of a constant twist over unit time, (..., 3, 3) from (..., 3) ([1]_ eq. 156)."""
    v = as_batch("xi", xi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.se2_exp, v, 1, (3, 3))
    theta = v[..., 0]
    theta2 = np.asarray(theta * theta)
    V = _scaled_rotation(_series.sinc(theta2), theta * _series.versine(theta2))
    return _from_parts(so2.exp(v[..., :1]), (V @ v[..., 1:, None])[..., 0], ())


def log(T: ArrayLike) -> Array:
    """Return the tangent vector with an angle in [-pi, pi], (..., 3) from (..., 3, 3) ([1]_ eq. 157)."""
    m = as_batch("T", T, (3, 3))
    if m.ndim > 2:
        return _batch.each(_core.se2_log, m, 2, (3,))
    theta = so2.log(m[..., :2, :2])[..., 0]
    rho = np.swapaxes(_inverse_arc(theta), -1, -2) @ m[..., :2, 2:]
    return np.concatenate([theta[..., None], rho[..., 0]], axis=-1)


def _inverse_arc(theta: Array) -> Array:
    """Return the inverse of the translation block of the right Jacobian, (..., 2, 2)."""
    theta2 = np.asarray(theta * theta)
    return _scaled_rotation(1.0 - theta2 * _series.half_cotangent_defect(theta2), 0.5 * theta)


def compose(T_a_b: ArrayLike, T_b_c: ArrayLike) -> Array:
    """Return ``T_a_c = T_a_b @ T_b_c``."""
    a, b = as_batch("T_a_b", T_a_b, (3, 3)), as_batch("T_b_c", T_b_c, (3, 3))
    if a.shape != b.shape:
        match("T_a_b and T_b_c", a.shape, b.shape)
    if a.ndim > 2 and a.shape == b.shape:
        return _batch.each_pair(_core.se2_compose, a, b)
    return np.asarray(a @ b)


def inverse(T: ArrayLike) -> Array:
    """Return ``T_b_a`` from ``T_a_b``, (..., 3, 3)."""
    m = as_batch("T", T, (3, 3))
    if m.ndim > 2:
        return _batch.each(_core.se2_inverse, m, 2, (3, 3))
    R_b_a = np.swapaxes(m[..., :2, :2], -1, -2)
    return _from_parts(R_b_a, -(R_b_a @ m[..., :2, 2:])[..., 0], m.shape[:-2])


def act(T: ArrayLike, points: ArrayLike) -> Array:
    """Return ``p_a = T_a_b @ p_b`` for points (..., 2); one motion acts on all, a batch element by element."""
    m, p = as_batch("T", T, (3, 3)), as_batch("points", points, (2,))
    if m.ndim == 2:
        return np.asarray(p @ m[:2, :2].T + m[:2, 2], dtype=np.float64)
    match("T and points", m.shape[:-2], p.shape[:-1])
    return np.asarray((m[..., :2, :2] @ p[..., None])[..., 0] + m[..., :2, 2], dtype=np.float64)


def _assemble(coupling: Array, block: Array) -> Array:
    """Return ``[[1, 0], [coupling, block]]``, (..., 3, 3)."""
    out = np.zeros((*block.shape[:-2], 3, 3))
    out[..., 0, 0] = 1.0
    out[..., 1:, 0] = coupling
    out[..., 1:, 1:] = block
    return out


def adjoint(T: ArrayLike) -> Array:
    """Return Ad with ``T exp(d) = exp(Ad d) T``, (..., 3, 3), rotation first ([1]_ eq. 159)."""
    m = as_batch("T", T, (3, 3))
    if m.ndim > 2:
        return _batch.each(_core.se2_adjoint, m, 2, (3, 3))
    return _assemble(np.stack([m[..., 1, 2], -m[..., 0, 2]], axis=-1), m[..., :2, :2])


def _right_parts(xi: ArrayLike) -> tuple[Array, Array, Array]:
    """Return theta, the coupling column (..., 2) and the translation block (..., 2, 2) of the right Jacobian."""
    v = as_batch("xi", xi, (3,))
    theta, x, y = v[..., 0], v[..., 1], v[..., 2]
    theta2 = np.asarray(theta * theta)
    b, c = _series.versine(theta2), theta * _series.cubic_defect(theta2)
    coupling = np.stack([x * c - y * b, x * b + y * c], axis=-1)
    return theta, coupling, _scaled_rotation(_series.sinc(theta2), -theta * b)


def right_jacobian(xi: ArrayLike) -> Array:
    """Return Jr with ``exp(xi + d) = exp(xi) exp(Jr d)`` to first order, (..., 3, 3) ([1]_ eq. 163)."""
    v = as_batch("xi", xi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.se2_right_jacobian, v, 1, (3, 3))
    _, coupling, block = _right_parts(v)
    return _assemble(coupling, block)


def right_jacobian_inverse(xi: ArrayLike) -> Array:
    """Return the inverse of `right_jacobian`, (..., 3, 3); singular at a full turn."""
    v = as_batch("xi", xi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.se2_right_jacobian_inverse, v, 1, (3, 3))
    theta, coupling, _ = _right_parts(v)
    block = _inverse_arc(theta)
    return _assemble(-(block @ coupling[..., None])[..., 0], block)


def retract(T: ArrayLike, d: ArrayLike) -> Array:
    """Return ``T @ exp(d)``."""
    return compose(as_batch("T", T, (3, 3)), exp(as_batch("d", d, (3,))))


def local(T_a: ArrayLike, T_b: ArrayLike) -> Array:
    """Return the d with ``retract(T_a, d) = T_b``, (..., 3)."""
    return log(compose(inverse(as_batch("T_a", T_a, (3, 3))), as_batch("T_b", T_b, (3, 3))))
