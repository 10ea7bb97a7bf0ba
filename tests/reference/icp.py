"""The slow, obvious twin of the native registration kernel: loops over elements, partners by brute force."""

import numpy as np

from heliograph.lie import so3


def elements_of(native, level):
    names = ("mean", "centre", "axes", "values", "count", "support", "shape")
    arrays = dict(zip(names, native.elements(level), strict=True))
    return {name: np.asarray(a, dtype=np.float64) for name, a in arrays.items()}


def _plane_variance(t, j, d):
    tilt = sum((t["axes"][j, k] @ d) ** 2 / t["values"][j, k] for k in (1, 2) if t["values"][j, k] > 0.0)
    return t["values"][j, 0] / max(t["support"][j], 1.0) * (1.0 + tilt)


def _spread(e, i, R, across, along):
    if e["shape"][i] != 1:
        return 0.25 * along * np.eye(3), 0.25 * along
    n = R @ e["axes"][i, 0]
    return along * np.eye(3) + (across - along) * np.outer(n, n), across


def term(residual, t, j, s, i, p, R, floor2, along):
    """Return information matrix (3, 3), vector, length and variance of one residual, or None."""
    own = s["values"][i, 0] / max(s["count"][i], 1.0)
    if residual == "point":
        r = p - t["mean"][j]
        return np.eye(3) / floor2, r, np.linalg.norm(r), floor2
    if residual == "plane":
        if t["shape"][j] != 1:
            return None
        n, d = t["axes"][j, 0], p - t["centre"][j]
        variance = floor2 + _plane_variance(t, j, d) + own
        return np.outer(n, n) / variance, d, n @ d, variance
    if residual == "edge":
        if t["shape"][j] != 2:
            return None
        u, d = t["axes"][j, 2], p - t["centre"][j]
        P = np.eye(3) - np.outer(u, u)
        variance = floor2 + t["values"][j, 1] / t["support"][j] + own
        return P / variance, P @ d, np.linalg.norm(P @ d), variance
    flat = t["shape"][j] == 1
    d = p - (t["centre"][j] if flat else t["mean"][j])
    reach = max(along, t["values"][j, 2]) if flat else along
    C, a = _spread(t, j, np.eye(3), floor2 + (_plane_variance(t, j, d) if flat else 0.0), reach)
    D, b = _spread(s, i, R, floor2 + own, along)
    omega = np.linalg.inv(C + D)
    return omega, d, np.sqrt(max(d @ omega @ d, 0.0) * (a + b)), a + b


def icp_sums(target, source, T, residual, *, gate, kernel, sigma, min_cosine, edge):
    """Return information (6, 6), gradient (6,), cost, weight, matches of nearest partners."""
    t, s, R = target, source, T[:3, :3]
    H, g, cost, weight, matches = np.zeros((6, 6)), np.zeros(6), 0.0, 0.0, 0
    along = 0.25 * (edge if edge > 0.0 else 0.5 * gate) ** 2
    for i, m in enumerate(s["mean"]):
        p = R @ m + T[:3, 3]
        distance = np.linalg.norm(t["mean"] - p, axis=1)
        j = int(np.argmin(distance))
        if distance[j] > gate:
            continue
        both = t["shape"][j] == 1 and s["shape"][i] == 1
        if both and min_cosine > 0.0 and abs(t["axes"][j, 0] @ R @ s["axes"][i, 0]) < min_cosine:
            continue
        found = term(residual, t, j, s, i, p, R, sigma**2, along)
        if found is None:
            continue
        omega, r, length, variance = found
        c2 = kernel**2
        w = (c2 / (c2 + length**2)) ** 2 if kernel > 0.0 else 1.0
        J = np.hstack([-R @ so3.hat(m), R])
        H += w * J.T @ omega @ J
        g += w * J.T @ omega @ r
        cost += 0.5 * length**2 * (c2 / (c2 + length**2) if kernel > 0.0 else 1.0) / variance
        weight += w
        matches += 1
    return H, g, cost, weight, matches
