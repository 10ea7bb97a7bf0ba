"""Extended poses: attitude, position and velocity as 5x5 matrices, the group SE_2(3), batched.

Elements have shape ``(..., 5, 5)``: rotation, then the columns position [m] and velocity [m/s]. Tangent vectors have
shape ``(..., 9)`` with the rotation first: ``(theta_x, theta_y, theta_z, x, y, z, vx, vy, vz)``, all float64.
Perturbations are on the right: ``X.retract(d) = X @ exp(d)``. The group does not act on points.

References
----------
.. [1] A. Barrau, S. Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE TAC, 2017.
.. [2] M. Brossard, A. Barrau, P. Chauchat, S. Bonnabel, "Associating uncertainty to extended poses for on Lie group IMU
   preintegration with rotating Earth", IEEE T-RO, 2022, appendix (both columns behave as the one of SE(3)).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array, as_batch, broadcast, match
from heliograph.lie import se3, so3

__all__ = [
    "adjoint",
    "compose",
    "exp",
    "from_rotation_position_velocity",
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
    """Return identity elements, (*batch, 5, 5)."""
    return np.tile(np.eye(5), (*batch, 1, 1))


def _assemble(R: Array, columns: Array) -> Array:
    """Return ``[[R, columns], [0, I]]``, (..., 5, 5) from (..., 3, 3) and (..., 3, 2)."""
    out = np.zeros((*np.broadcast_shapes(R.shape[:-2], columns.shape[:-2]), 5, 5))
    out[..., :3, :3] = R
    out[..., :3, 3:] = columns
    out[..., 3, 3] = out[..., 4, 4] = 1.0
    return out


def from_rotation_position_velocity(R: ArrayLike, p: ArrayLike, v: ArrayLike) -> Array:
    """Return elements from rotations (..., 3, 3), positions (..., 3) [m] and velocities (..., 3) [m/s], broadcast."""
    r, position, velocity = as_batch("R", R, (3, 3)), as_batch("p", p, (3,)), as_batch("v", v, (3,))
    broadcast("R, p and v", r.shape[:-2], position.shape[:-1], velocity.shape[:-1])
    position, velocity = np.broadcast_arrays(position, velocity)
    return _assemble(r, np.stack([position, velocity], axis=-1))


def _columns(v: Array) -> Array:
    """Return the two translational parts of a tangent vector as columns, (..., 3, 2) from (..., 9)."""
    return np.stack([v[..., 3:6], v[..., 6:]], axis=-1)


def hat(xi: ArrayLike) -> Array:
    """Return the 5x5 matrix of a tangent vector, (..., 5, 5) from (..., 9)."""
    v = as_batch("xi", xi, (9,))
    out = np.zeros((*v.shape[:-1], 5, 5))
    out[..., :3, :3] = so3.hat(v[..., :3])
    out[..., :3, 3:] = _columns(v)
    return out


def exp(xi: ArrayLike) -> Array:
    """Return the element of a tangent vector, (..., 5, 5) from (..., 9)."""
    v = as_batch("xi", xi, (9,))
    return _assemble(so3.exp(v[..., :3]), so3.left_jacobian(v[..., :3]) @ _columns(v))


def log(X: ArrayLike) -> Array:
    """Return the tangent vector with a rotation of length in [0, pi], (..., 9) from (..., 5, 5)."""
    m = as_batch("X", X, (5, 5))
    phi = so3.log(m[..., :3, :3])
    rho = so3.left_jacobian_inverse(phi) @ m[..., :3, 3:]
    return np.concatenate([phi, rho[..., 0], rho[..., 1]], axis=-1)


def compose(X_a_b: ArrayLike, X_b_c: ArrayLike) -> Array:
    """Return ``X_a_b @ X_b_c``."""
    a, b = as_batch("X_a_b", X_a_b, (5, 5)), as_batch("X_b_c", X_b_c, (5, 5))
    match("X_a_b and X_b_c", a.shape, b.shape)
    return np.asarray(a @ b)


def inverse(X: ArrayLike) -> Array:
    """Return the inverses, (..., 5, 5)."""
    m = as_batch("X", X, (5, 5))
    transposed = np.swapaxes(m[..., :3, :3], -1, -2)
    return _assemble(transposed, -(transposed @ m[..., :3, 3:]))


def _block_lower(rotation: Array, position: Array, velocity: Array) -> Array:
    """Return ``[[rotation, 0, 0], [position, rotation, 0], [velocity, 0, rotation]]``, (..., 9, 9)."""
    out = np.zeros((*position.shape[:-2], 9, 9))
    for k in range(0, 9, 3):
        out[..., k : k + 3, k : k + 3] = rotation
    out[..., 3:6, :3] = position
    out[..., 6:, :3] = velocity
    return out


def adjoint(X: ArrayLike) -> Array:
    """Return Ad with ``X exp(d) = exp(Ad d) X``, (..., 9, 9), rotation first."""
    m = as_batch("X", X, (5, 5))
    R = m[..., :3, :3]
    return _block_lower(R, so3.hat(m[..., :3, 3]) @ R, so3.hat(m[..., :3, 4]) @ R)


def right_jacobian(xi: ArrayLike) -> Array:
    """Return Jr with ``exp(xi + d) = exp(xi) exp(Jr d)`` to first order, (..., 9, 9).

    Position and velocity each couple to the rotation as the translation of SE(3) does, and not to each other.
    """
    v = as_batch("xi", xi, (9,))
    with_position = se3.right_jacobian(v[..., :6])
    with_velocity = se3.right_jacobian(np.concatenate([v[..., :3], v[..., 6:]], axis=-1))
    return _block_lower(with_position[..., :3, :3], with_position[..., 3:, :3], with_velocity[..., 3:, :3])


def right_jacobian_inverse(xi: ArrayLike) -> Array:
    """Return the inverse of `right_jacobian`, (..., 9, 9); singular at a full turn."""
    v = as_batch("xi", xi, (9,))
    with_position = se3.right_jacobian_inverse(v[..., :6])
    with_velocity = se3.right_jacobian_inverse(np.concatenate([v[..., :3], v[..., 6:]], axis=-1))
    return _block_lower(with_position[..., :3, :3], with_position[..., 3:, :3], with_velocity[..., 3:, :3])


def retract(X: ArrayLike, d: ArrayLike) -> Array:
    """Return ``X @ exp(d)``."""
    x, v = as_batch("X", X, (5, 5)), as_batch("d", d, (9,))
    match("X and d", x.shape[:-2], v.shape[:-1])
    return np.asarray(x @ exp(v))


def local(X_a: ArrayLike, X_b: ArrayLike) -> Array:
    """Return the d with ``retract(X_a, d) = X_b``, (..., 9)."""
    a, b = as_batch("X_a", X_a, (5, 5)), as_batch("X_b", X_b, (5, 5))
    match("X_a and X_b", a.shape, b.shape)
    return log(inverse(a) @ b)
