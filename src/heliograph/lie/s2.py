"""Directions in space: unit vectors (..., 3) with a tangent of two dimensions (..., 2) [rad], float64, batched.

Made for the direction of gravity: two errors, not three. The tangent plane is spanned by `basis`; `retract` follows
the great circle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array, as_batch, match
from heliograph.lie import _series

__all__ = ["basis", "local", "project", "retract", "retract_jacobian"]


# No basis is smooth on the whole sphere. This one is where gravity lives: the seam is at 60 degrees above the horizon.
_SEAM = 0.866


def project(v: ArrayLike) -> Array:
    """Return unit vectors along ``v``, (..., 3)."""
    x = as_batch("v", v, (3,))
    return np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True), dtype=np.float64)


def basis(x: ArrayLike) -> Array:
    """Return an orthonormal basis of the tangent plane at ``x``, (..., 3, 2) from (..., 3).

    The columns and ``x`` form a right-handed frame. A fixed smooth function of ``x`` for every direction up to 60
    degrees above the horizon (T. Duff et al., "Building an orthonormal basis, revisited", JCGT 2017, seam moved there).
    """
    v = as_batch("x", x, (3,))
    nx, ny, nz = v[..., 0], v[..., 1], v[..., 2]
    s = np.where(nz > _SEAM, 1.0, -1.0)
    a = -1.0 / (s + nz)
    b = nx * ny * a
    first = np.stack([1.0 + s * nx * nx * a, s * b, -s * nx], axis=-1)
    second = np.stack([b, s + ny * ny * a, -ny], axis=-1)
    return np.stack([first, second], axis=-1)


def retract(x: ArrayLike, d: ArrayLike) -> Array:
    """Return the direction reached from ``x`` along ``basis(x) @ d`` by the angle ``|d|``, (..., 3)."""
    v, d = as_batch("x", x, (3,)), as_batch("d", d, (2,))
    match("x and d", v.shape[:-1], d.shape[:-1])
    step = (basis(v) @ d[..., None])[..., 0]
    theta2 = np.asarray(np.einsum("...i,...i->...", d, d))
    y = np.cos(np.sqrt(theta2))[..., None] * v + _series.sinc(theta2)[..., None] * step
    # The length is 1 up to rounding; without this it would walk away over many small steps.
    return project(y)


def local(x: ArrayLike, y: ArrayLike) -> Array:
    """Return the d with ``retract(x, d) = y`` and ``|d|`` in [0, pi], (..., 2).

    For opposite directions it lies along the first basis vector.
    """
    v, w = as_batch("x", x, (3,)), as_batch("y", y, (3,))
    match("x and y", v.shape, w.shape)
    tangent = (np.swapaxes(basis(v), -1, -2) @ w[..., None])[..., 0]
    sine = np.linalg.norm(tangent, axis=-1)
    angle = np.arctan2(sine, np.einsum("...i,...i->...", v, w))
    scale = angle / np.where(sine > 0.0, sine, 1.0)
    along_first = np.stack([angle, np.zeros_like(angle)], axis=-1)
    return np.asarray(np.where(sine[..., None] > 0.0, tangent * scale[..., None], along_first), dtype=np.float64)


def retract_jacobian(x: ArrayLike, d: ArrayLike) -> Array:
    """Return the derivative of ``retract(x, d)`` by ``d``, (..., 3, 2); at ``d = 0`` it is `basis`."""
    v, d = as_batch("x", x, (3,)), as_batch("d", d, (2,))
    match("x and d", v.shape[:-1], d.shape[:-1])
    B = basis(v)
    step = (B @ d[..., None])[..., 0]
    theta2 = np.asarray(np.einsum("...i,...i->...", d, d))
    sinc, slope = _series.sinc(theta2)[..., None, None], _series.sinc_slope(theta2)[..., None, None]
    along = slope * step[..., None] - sinc * v[..., None]
    return np.asarray(sinc * B + along * d[..., None, :], dtype=np.float64)
