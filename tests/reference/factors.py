"""Slow, obvious twin of the native factors: one factor at a time, by matrices and the functions of `heliograph.lie`.

Elements are matrices (SO(2) 2x2, SO(3) 3x3, SE(2) 3x3, SE(3) 4x4, SE_2(3) 5x5) or vectors (S(2), plain vectors).
"""

from __future__ import annotations

import numpy as np

from heliograph.lie import s2, se2, se3, se23, so2, so3

VECTOR, SO2, SO3, SE2, SE3, S2, NAV = range(7)
CUSTOM, PRIOR, BETWEEN, RANGE, BEARING, LANDMARK, POSITION, LINEAR_MOTION = range(8)
SCALAR, DIAGONAL, FULL = range(3)
NO_KERNEL, HUBER, CAUCHY, GEMAN_MCCLURE, TUKEY, DCS, TRUNCATED = range(7)
DOF = {SO2: 1, SO3: 3, SE2: 3, SE3: 6, S2: 2, NAV: 9}

GROUPS = {SO2: so2, SO3: so3, SE2: se2, SE3: se3, NAV: se23}


def pack(manifold, x):
    """Return the numbers of one element as the native side stores them."""
    if manifold in (SO2, SE2):
        return np.concatenate([x[:2, 0], x[:2, 2] if manifold == SE2 else []])
    if manifold in (SO3, SE3, NAV):
        return np.concatenate([x[:3, :3].ravel(), x[:3, 3:].T.ravel()])
    return np.asarray(x, dtype=np.float64)


def unpack(manifold, v):
    """Return the element of its numbers."""
    if manifold in (SO2, SE2):
        out = np.eye(2 if manifold == SO2 else 3)
        out[:2, :2] = [[v[0], -v[1]], [v[1], v[0]]]
        if manifold == SE2:
            out[:2, 2] = v[2:]
        return out
    if manifold in (SO3, SE3, NAV):
        out = np.eye({SO3: 3, SE3: 4, NAV: 5}[manifold])
        out[:3, :3] = v[:9].reshape(3, 3)
        out[:3, 3:] = v[9:].reshape(-1, 3).T
        return out
    return v


def retract(manifold, x, d):
    if manifold == VECTOR:
        return x + d
    if manifold == S2:
        return s2.retract(x, d)
    return x @ GROUPS[manifold].exp(d)


def _point(manifold, x):
    return x if manifold == VECTOR else x[:-1, -1] if manifold != NAV else x[:3, 3]


def _rotation(manifold, x):
    return x[:2, :2] if manifold == SE2 else x[:3, :3]


def _seen(manifolds, x):
    """Return the point of the second variable in the frame of the first."""
    return _rotation(manifolds[0], x[0]).T @ (_point(manifolds[1], x[1]) - _point(manifolds[0], x[0]))


def residual(kind, manifolds, x, z):
    """Return the unwhitened residual; ``z`` is an element for prior and between, else the packed numbers."""
    if kind in (PRIOR, BETWEEN):
        if manifolds[0] == VECTOR:
            return x[-1] - z - (x[0] if kind == BETWEEN else 0.0)
        if manifolds[0] == S2:
            return s2.local(z, x[0])
        group = GROUPS[manifolds[0]]
        X = x[0] if kind == PRIOR else group.inverse(x[0]) @ x[1]
        return group.log(group.inverse(z) @ X)
    if kind == RANGE:
        return np.linalg.norm(_point(manifolds[1], x[1]) - _point(manifolds[0], x[0])) - z
    if kind == BEARING:
        q = _seen(manifolds, x)
        if len(q) == 3:
            return s2.local(z, s2.project(q))
        return np.array([np.arctan2(z[0] * q[1] - z[1] * q[0], z @ q)])
    if kind == LANDMARK:
        return _seen(manifolds, x) - z
    if kind == POSITION:
        return _point(manifolds[0], x[0]) - z
    n, m = len(x[0]), len(x[1])
    return x[1] - z[: m * n].reshape(m, n) @ x[0] - z[m * n :]


def jacobians(kind, manifolds, x, z):
    """Return the Jacobians of prior and between on groups, from the right Jacobian and the adjoint."""
    group = GROUPS[manifolds[0]]
    J = group.right_jacobian_inverse(residual(kind, manifolds, x, z))
    if kind == PRIOR:
        return [J]
    return [-J @ group.adjoint(group.inverse(group.inverse(x[0]) @ x[1])), J]


def numeric_jacobians(kind, manifolds, x, z, step=1e-3):
    """Return the Jacobians of any factor by a five-point stencil."""
    out = []
    for a, manifold in enumerate(manifolds):
        dof = DOF.get(manifold, np.size(x[a]))
        columns = []
        for i in range(dof):

            def at(h, a=a, i=i, dof=dof, manifold=manifold):
                moved = list(x)
                moved[a] = retract(manifold, x[a], h * np.eye(dof)[i])
                return np.atleast_1d(residual(kind, manifolds, moved, z))

            columns.append((8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step))
        out.append(np.stack(columns, axis=1))
    return out


def rho(kernel, width, e):
    """Return (2 rho(e), rho'(e) / e) of a whitened length."""
    k, r2 = width, e * e
    if kernel == HUBER:
        return (r2, 1.0) if e <= k else (2.0 * k * (e - k / 2.0), k / e)
    if kernel == CAUCHY:
        return k * k * np.log1p(r2 / k**2), 1.0 / (1.0 + r2 / k**2)
    if kernel == GEMAN_MCCLURE:
        return r2 / (1.0 + r2 / k**2), (k * k / (k * k + r2)) ** 2
    if kernel == TUKEY:
        rest = max(0.0, 1.0 - r2 / k**2)
        return k * k / 3.0 * (1.0 - rest**3), rest**2
    if kernel == DCS:
        s = min(1.0, 2.0 * k / (k + r2))
        # The integral of e s(e)^2, by a primitive of each piece.
        return (r2 if r2 <= k else 3.0 * k - 4.0 * k * k / (k + r2)), s * s
    if kernel == TRUNCATED:
        return min(r2, k * k), float(r2 <= k * k)
    return r2, 1.0


def whiten(form, S, value):
    """Return S times a vector or matrix."""
    if form == FULL:
        return S.reshape(len(value), len(value)) @ value
    return (S if form == SCALAR else S.reshape(-1, *[1] * (np.ndim(value) - 1))) * value


def linearized(r, J, *, form, S, kernel=NO_KERNEL, width=1.0, weight=1.0, shift=0.0):
    """Return (blocks, chi2, cost) of one factor, laid out as the native side does."""
    white = whiten(form, S, r)
    A = [whiten(form, S, j) for j in J]
    chi2 = white @ white
    white = white + shift
    cost, robust = rho(kernel, width, np.linalg.norm(white))
    w = weight * robust
    blocks = [w * A[a].T @ A[b] for a in range(len(A)) for b in range(a, len(A))]
    gradients = [w * a.T @ white for a in A]
    return np.concatenate([b.ravel() for b in blocks + gradients]), chi2, weight * cost
