"""The slow, obvious twin of the fast point feature histograms."""

import numpy as np

BINS, NEIGHBOURS = 11, 80


def _bin(share):
    return min(BINS - 1, int(max(0.0, share) * BINS))


def _normalised(h):
    h = h.reshape(3, BINS)
    total = h.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, 100.0 * h / np.where(total > 0.0, total, 1.0), 0.0).ravel()


def point_features(places, normals, radius):
    """Return (N, 33): of each place three histograms of the angles to its neighbours, then theirs by distance."""
    places, normals = places.astype(np.float64), normals.astype(np.float64)
    normals = np.where((np.einsum("ij,ij->i", places, normals) > 0.0)[:, None], -normals, normals)
    simple, near = [], []
    for p, n in zip(places, normals, strict=True):
        distance = np.linalg.norm(places - p, axis=1)
        close = [j for j in np.argsort(distance, kind="stable")[:NEIGHBOURS] if 0.0 < distance[j] <= radius]
        h = np.zeros(3 * BINS)
        for j in close:
            d = (places[j] - p) / distance[j]
            v = np.cross(n, d)
            if np.linalg.norm(v) < 1e-6:
                continue
            v /= np.linalg.norm(v)
            w = np.cross(n, v)
            h[_bin(0.5 * (np.arctan2(w @ normals[j], n @ normals[j]) / np.pi + 1.0))] += 1.0
            h[BINS + _bin(0.5 * (v @ normals[j] + 1.0))] += 1.0
            h[2 * BINS + _bin(0.5 * (n @ d + 1.0))] += 1.0
        simple.append(_normalised(h))
        near.append([(j, distance[j]) for j in close])
    out = []
    for i, close in enumerate(near):
        h = np.zeros(3 * BINS)
        for j, distance in close:
            h += simple[j] / distance
        out.append(_normalised(_normalised(h) + simple[i]))
    return np.array(out)
