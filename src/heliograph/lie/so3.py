"""Rotations in space: 3x3 matrices, batched.

Every function broadcasts over leading axes: rotations have shape ``(..., 3, 3)``, tangent vectors ``(..., 3)`` [rad],
all float64. Perturbations are on the right: ``R.retract(d) = R @ exp(d)``.

References
----------
.. [1] J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, appendix B.
.. [2] S. W. Shepperd, "Quaternion from rotation matrix", J. Guidance and Control, 1978.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from heliograph import _core
from heliograph.arrays import Array, as_batch, as_numbers, broadcast, match, require_finite
from heliograph.errors import DataError
from heliograph.lie import _batch, _series

__all__ = [
    "adjoint",
    "exp",
    "from_quaternion",
    "from_rpy",
    "from_two_vectors",
    "hat",
    "identity",
    "inverse",
    "left_jacobian",
    "left_jacobian_inverse",
    "local",
    "log",
    "project",
    "retract",
    "right_jacobian",
    "right_jacobian_inverse",
    "to_quaternion",
    "to_rpy",
    "vee",
]

Scalar: TypeAlias = Any  # a float, or an array of one value an element of the batch


def identity(batch: tuple[int, ...] = ()) -> Array:
    """Return identity rotations, (*batch, 3, 3)."""
    return np.tile(np.eye(3), (*batch, 1, 1))


def hat(phi: ArrayLike) -> Array:
    """Return the skew matrix with ``hat(a) @ b = a x b``, (..., 3, 3) from (..., 3)."""
    v = as_batch("phi", phi, (3,))
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 2, 1] = v[..., 0]
    out[..., 0, 2] = v[..., 1]
    out[..., 1, 0] = v[..., 2]
    out[..., 1, 2] = -v[..., 0]
    out[..., 2, 0] = -v[..., 1]
    out[..., 0, 1] = -v[..., 2]
    return out


def vee(skew: ArrayLike) -> Array:
    """Return the vector of a skew matrix, (..., 3) from (..., 3, 3); the symmetric part is ignored."""
    m = as_batch("skew", skew, (3, 3))
    twice = (m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1])
    return 0.5 * np.stack(twice, axis=-1)


def _components(phi: ArrayLike) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Return x, y, z and the squared angle: floats for one vector (a third of the cost), arrays for a batch."""
    v = as_batch("phi", phi, (3,))
    if v.ndim == 1:
        x, y, z = v.tolist()
        return x, y, z, x * x + y * y + z * z
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return x, y, z, x * x + y * y + z * z


def _quadratic(x: Scalar, y: Scalar, z: Scalar, p: Scalar, q: Scalar) -> Array:
    """Return ``I + p K + q K^2`` with ``K = hat(x, y, z)``: every map of this module has this form."""
    rows = (
        (1.0 - q * (y * y + z * z), q * x * y - p * z, q * x * z + p * y),
        (q * x * y + p * z, 1.0 - q * (x * x + z * z), q * y * z - p * x),
        (q * x * z - p * y, q * y * z + p * x, 1.0 - q * (x * x + y * y)),
    )
    if isinstance(x, float):
        return np.array(rows)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def exp(phi: ArrayLike) -> Array:
    """Return the rotation about ``phi`` by its length [rad], (..., 3, 3) from (..., 3) (Rodrigues; [1]_ eq. 134)."""
    v = as_batch("phi", phi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.so3_exp, v, 1, (3, 3))
    x, y, z, theta2 = _components(v)
    return _quadratic(x, y, z, _series.sinc(theta2), _series.versine(theta2))


def log(R: ArrayLike) -> Array:
    """Return the rotation vector of length in [0, pi], (..., 3) [rad] from (..., 3, 3).

    Accurate at every angle, pi included, where the sign of the axis is arbitrary but deterministic. A slightly
    non-orthonormal matrix gives the vector of a rotation near it.
    """
    r = as_batch("R", R, (3, 3))
    if r.ndim > 2:
        return _batch.each(_core.so3_log, r, 2, (3,))
    q = to_quaternion(r)
    v, w = q[..., :3], q[..., 3]
    n = np.sqrt(np.einsum("...i,...i->...", v, v))
    # atan2 keeps full relative accuracy at both ends; 2 / w is its limit for a vanishing vector part.
    scale = np.where(n > 0.0, 2.0 * np.arctan2(n, w) / np.where(n > 0.0, n, 1.0), 2.0)
    return np.asarray(v * scale[..., None], dtype=np.float64)


def left_jacobian(phi: ArrayLike) -> Array:
    """Return Jl with ``exp(phi + d) = exp(Jl d) exp(phi)`` to first order, (..., 3, 3) ([1]_ eq. 145)."""
    v = as_batch("phi", phi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.so3_left_jacobian, v, 1, (3, 3))
    x, y, z, theta2 = _components(v)
    return _quadratic(x, y, z, _series.versine(theta2), _series.cubic_defect(theta2))


def right_jacobian(phi: ArrayLike) -> Array:
    """Return Jr with ``exp(phi + d) = exp(phi) exp(Jr d)`` to first order, (..., 3, 3) ([1]_ eq. 143)."""
    v = as_batch("phi", phi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.so3_right_jacobian, v, 1, (3, 3))
    x, y, z, theta2 = _components(v)
    return _quadratic(x, y, z, -_series.versine(theta2), _series.cubic_defect(theta2))


def left_jacobian_inverse(phi: ArrayLike) -> Array:
    """Return the inverse of `left_jacobian`; singular at a full turn ([1]_ eq. 146)."""
    v = as_batch("phi", phi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.so3_left_jacobian_inverse, v, 1, (3, 3))
    x, y, z, theta2 = _components(v)
    return _quadratic(x, y, z, -0.5, _series.half_cotangent_defect(theta2))


def right_jacobian_inverse(phi: ArrayLike) -> Array:
    """Return the inverse of `right_jacobian`; singular at a full turn ([1]_ eq. 144)."""
    v = as_batch("phi", phi, (3,))
    if v.ndim > 1:
        return _batch.each(_core.so3_right_jacobian_inverse, v, 1, (3, 3))
    x, y, z, theta2 = _components(v)
    return _quadratic(x, y, z, 0.5, _series.half_cotangent_defect(theta2))


def inverse(R: ArrayLike) -> Array:
    """Return the transposes."""
    return np.swapaxes(as_batch("R", R, (3, 3)), -1, -2)


def adjoint(R: ArrayLike) -> Array:
    """Return Ad with ``R exp(d) = exp(Ad d) R``, which for rotations is R itself."""
    return np.array(as_batch("R", R, (3, 3)))


def retract(R: ArrayLike, d: ArrayLike) -> Array:
    """Return ``R @ exp(d)``."""
    r, v = as_batch("R", R, (3, 3)), as_batch("d", d, (3,))
    match("R and d", r.shape[:-2], v.shape[:-1])
    return np.asarray(r @ exp(v))


def local(R_a: ArrayLike, R_b: ArrayLike) -> Array:
    """Return the d with ``retract(R_a, d) = R_b``, that is ``log(R_a^T R_b)``."""
    a, b = as_batch("R_a", R_a, (3, 3)), as_batch("R_b", R_b, (3, 3))
    match("R_a and R_b", a.shape, b.shape)
    return log(np.swapaxes(a, -1, -2) @ b)


def from_quaternion(xyzw: ArrayLike) -> Array:
    """Return the rotations of quaternions (x, y, z, w) of any length, (..., 3, 3) from (..., 4).

    Raises
    ------
    DataError
        A quaternion is zero or not finite.
    """
    q = as_batch("xyzw", xyzw, (4,))
    norm = np.sqrt(np.einsum("...i,...i->...", q, q))
    if not np.all((norm > 1e-150) & np.isfinite(norm)):
        raise DataError("a quaternion is zero or not finite; a rotation needs a non-zero (x, y, z, w)")
    x, y, z, w = np.moveaxis(q / norm[..., None], -1, 0)
    # I + 2 w V + 2 V^2 with V the skew matrix of the vector part.
    return _quadratic(x, y, z, 2.0 * w, 2.0)


def to_quaternion(R: ArrayLike) -> Array:
    """Return unit quaternions (x, y, z, w) with w >= 0, (..., 4) from (..., 3, 3).

    The 4x4 matrix ``4 q q^T`` is linear in R; its row with the largest diagonal entry is the quaternion without loss of
    digits, whatever the angle [2]_.
    """
    r = as_batch("R", R, (3, 3))
    r00, r11, r22 = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    m = np.empty((*r.shape[:-2], 4, 4))
    m[..., 0, 0] = 1.0 + r00 - r11 - r22
    m[..., 1, 1] = 1.0 - r00 + r11 - r22
    m[..., 2, 2] = 1.0 - r00 - r11 + r22
    m[..., 3, 3] = 1.0 + r00 + r11 + r22
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        m[..., i, j] = m[..., j, i] = r[..., i, j] + r[..., j, i]
        m[..., k, 3] = m[..., 3, k] = r[..., j, i] - r[..., i, j]
    best = np.argmax(np.einsum("...ii->...i", m), axis=-1)
    q = np.take_along_axis(m, best[..., None, None], axis=-2)[..., 0, :]
    q /= np.sqrt(np.einsum("...i,...i->...", q, q))[..., None]
    return np.asarray(np.where(q[..., 3:] < 0.0, -q, q), dtype=np.float64)


def project(M: ArrayLike) -> Array:
    """Return the rotation nearest to each matrix in the Frobenius norm, (..., 3, 3)."""
    u, _, vt = np.linalg.svd(require_finite("M", as_batch("M", M, (3, 3))))
    # A reflection is turned into a rotation along the direction that costs least: the smallest singular value's.
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return np.asarray(u @ vt, dtype=np.float64)


def from_two_vectors(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the smallest rotation that turns direction a into direction b, (..., 3, 3) from two (..., 3).

    For opposite directions the axis is arbitrary but deterministic.

    Raises
    ------
    DataError
        A vector is zero or not finite.
    """
    u, v = as_batch("a", a, (3,)), as_batch("b", b, (3,))
    match("a and b", u.shape[:-1], v.shape[:-1])
    lengths = np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1)
    if not np.all((lengths > 0.0) & np.isfinite(lengths)):
        raise DataError("a direction needs a non-zero finite vector")
    u = u / np.linalg.norm(u, axis=-1, keepdims=True)
    v = v / np.linalg.norm(v, axis=-1, keepdims=True)
    cross = np.cross(u, v)
    sine = np.linalg.norm(cross, axis=-1, keepdims=True)
    cosine = np.einsum("...i,...i->...", u, v)[..., None]
    # Opposite: turn half round about any normal of u, here its cross product with the axis that it is farthest from.
    normal = np.cross(u, np.eye(3)[np.argmin(np.abs(u), axis=-1)])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    opposite = (sine < 1e-12) & (cosine < 0.0)
    axis = np.where(opposite, normal, cross / np.where(sine > 0.0, sine, 1.0))
    return exp(axis * np.where(opposite, np.pi, np.arctan2(sine, cosine)))


def from_rpy(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Return ``Rz(yaw) @ Ry(pitch) @ Rx(roll)``, (..., 3, 3) from three (...) [rad]."""
    x, y, z = np.eye(3)
    given = {"roll": roll, "pitch": pitch, "yaw": yaw}
    r, p, w = (as_numbers(name, angle)[..., None] for name, angle in given.items())
    broadcast("roll, pitch and yaw", r.shape[:-1], p.shape[:-1], w.shape[:-1])
    return exp(w * z) @ exp(p * y) @ exp(r * x)


def to_rpy(R: ArrayLike) -> Array:
    """Return (roll, pitch, yaw) with ``R = Rz(yaw) Ry(pitch) Rx(roll)``, (..., 3) [rad].

    For people to read, not to compute with. Pitch is in [-pi/2, pi/2]. At its ends only a combination of roll and yaw
    exists; roll is then 0.
    """
    r = as_batch("R", R, (3, 3))
    level = np.hypot(r[..., 0, 0], r[..., 1, 0])
    pitch = np.arctan2(-r[..., 2, 0], level)
    locked = level < 1e-9
    roll = np.where(locked, 0.0, np.arctan2(r[..., 2, 1], r[..., 2, 2]))
    yaw = np.where(locked, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    return np.stack([roll, pitch, yaw], axis=-1)
