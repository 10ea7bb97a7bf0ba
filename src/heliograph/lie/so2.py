"""Rotations in the plane: 2x2 matrices (..., 2, 2), tangent vectors (..., 1) [rad], float64, batched."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

__all__ = [
    "adjoint",
    "exp",
    "hat",
    "identity",
    "inverse",
    "local",
    "log",
    "retract",
    "right_jacobian",
    "right_jacobian_inverse",
]

from heliograph.arrays import Array, as_batch, match


def identity(batch: tuple[int, ...] = ()) -> Array:
    """Return identity rotations, (*batch, 2, 2)."""
    return np.tile(np.eye(2), (*batch, 1, 1))


def hat(phi: ArrayLike) -> Array:
    """Return ``[[0, -t], [t, 0]]``, (..., 2, 2) from (..., 1)."""
    t = as_batch("phi", phi, (1,))[..., 0]
    out = np.zeros((*t.shape, 2, 2))
    out[..., 1, 0] = t
    out[..., 0, 1] = -t
    return out


def exp(phi: ArrayLike) -> Array:
    """Return the rotation by an angle, (..., 2, 2) from (..., 1)."""
    t = as_batch("phi", phi, (1,))[..., 0]
    out = np.empty((*t.shape, 2, 2))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(t)
    out[..., 1, 0] = np.sin(t)
    out[..., 0, 1] = -out[..., 1, 0]
    return out


def log(R: ArrayLike) -> Array:
    """Return the angle in [-pi, pi], (..., 1) from (..., 2, 2)."""
    r = as_batch("R", R, (2, 2))
    return np.asarray(np.arctan2(r[..., 1, 0], r[..., 0, 0]), dtype=np.float64)[..., None]


def inverse(R: ArrayLike) -> Array:
    """Return the transposes."""
    return np.swapaxes(as_batch("R", R, (2, 2)), -1, -2)


def _ones(batch: tuple[int, ...]) -> Array:
    return np.ones((*batch, 1, 1))


def adjoint(R: ArrayLike) -> Array:
    """Return 1, (..., 1, 1): planar rotations commute."""
    return _ones(as_batch("R", R, (2, 2)).shape[:-2])


def right_jacobian(phi: ArrayLike) -> Array:
    """Return 1, (..., 1, 1)."""
    return _ones(as_batch("phi", phi, (1,)).shape[:-1])


def right_jacobian_inverse(phi: ArrayLike) -> Array:
    """Return 1, (..., 1, 1)."""
    return _ones(as_batch("phi", phi, (1,)).shape[:-1])


def retract(R: ArrayLike, d: ArrayLike) -> Array:
    """Return ``R @ exp(d)``."""
    r, v = as_batch("R", R, (2, 2)), as_batch("d", d, (1,))
    match("R and d", r.shape[:-2], v.shape[:-1])
    return np.asarray(r @ exp(v))


def local(R_a: ArrayLike, R_b: ArrayLike) -> Array:
    """Return the d with ``retract(R_a, d) = R_b``, (..., 1)."""
    a, b = as_batch("R_a", R_a, (2, 2)), as_batch("R_b", R_b, (2, 2))
    match("R_a and R_b", a.shape, b.shape)
    return log(np.swapaxes(a, -1, -2) @ b)
