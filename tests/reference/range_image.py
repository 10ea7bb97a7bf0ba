"""The slow, obvious twin of what a scan saw by direction."""

import numpy as np

MARGIN, MARGIN_SHARE = 0.4, 0.02


def _cells(places, columns):
    scale = columns / (2.0 * np.pi)
    rows = columns // 2 + 1
    r = np.linalg.norm(places, axis=1)
    azimuth = np.arctan2(places[:, 1], places[:, 0]) + np.pi
    elevation = np.arcsin(np.clip(places[:, 2] / r, -1.0, 1.0)) + 0.5 * np.pi
    return r, (azimuth * scale).astype(int) % columns, np.minimum((elevation * scale).astype(int), rows - 1)


def sight(points, cell, to, elements, T, reach):
    """Return how many of ``elements`` are near one of ``to`` at T, should be seen, and are seen through."""
    columns = max(4, round(2.0 * np.pi / cell))
    rows = columns // 2 + 1
    low, high = np.full((columns, rows), np.inf), np.zeros((columns, rows))
    for r, c, k in zip(*_cells(points.astype(np.float64), columns), strict=True):
        low[c, k], high[c, k] = min(low[c, k], r), max(high[c, k], r)
    counts = np.zeros(3, dtype=int)
    moved = elements.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    for q, r, c, k in zip(moved, *_cells(moved, columns), strict=True):
        near = np.linalg.norm(to.astype(np.float64) - q, axis=1).min() <= reach
        around = [((c + i) % columns, j) for i in (-1, 0, 1) for j in range(max(k - 1, 0), min(k + 1, rows - 1) + 1)]
        nearest, farthest = min(low[a] for a in around), max(high[a] for a in around)
        margin = max(MARGIN, MARGIN_SHARE * r)
        looked = np.isfinite(low[c, k])
        through = looked and nearest > r + margin
        hidden = looked and not through and farthest < r - margin
        counts += [near, near or (looked and not hidden), through and not near]
    return tuple(counts.tolist())
