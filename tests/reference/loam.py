"""Slow, obvious twins of the kernels of LOAM: scan lines, curvature, means in cubes, lines and planes through them."""

import numpy as np


def lines_slowly(points, times, rows):
    """Return lines as lists of indices, by time, by azimuth where all times are one; of a beam the farthest return."""
    lines = []
    for row in sorted(set(rows.tolist())):
        line = [k for k in np.flatnonzero(rows == row) if np.isfinite(points[k]).all() and points[k].any()]
        if not line:
            continue
        if len({times[k] for k in line}) > 1:
            line.sort(key=lambda k: times[k])
        else:
            line.sort(key=lambda k: (np.arctan2(points[k][1], points[k][0]), k))
        kept = []
        for k in line:
            r = np.linalg.norm(points[k])
            if kept and np.linalg.norm(points[k] / r - points[kept[-1]] / np.linalg.norm(points[kept[-1]])) <= 2e-4:
                if r > np.linalg.norm(points[kept[-1]]):
                    kept[-1] = k
            else:
                kept.append(k)
        lines.append(kept)
    return lines


def offsets_slowly(xyz, window):
    """Return how far each point lies from the mean of its neighbours, across the line through the outer two."""
    out = np.full(len(xyz), np.nan)
    for k in range(window, len(xyz) - window):
        around = [xyz[j] for j in range(k - window, k + window + 1) if j != k]
        d = np.mean(around, axis=0) - xyz[k]
        t = xyz[k + window] - xyz[k - window]
        out[k] = np.linalg.norm(d - t * (d @ t) / (t @ t))
    return out


def unfit_slowly(xyz, config):
    """Return what must not be picked, and which points are the rim of a nearer surface."""
    n, w = len(xyz), config.window
    ranges = np.linalg.norm(xyz, axis=1)
    beams = xyz / ranges[:, None]
    steps = np.sum(np.diff(beams, axis=0) ** 2, axis=1)
    usual = np.sort(steps)[len(steps) // 2]
    unfit, rim = (np.zeros(n, bool) for _ in range(2))
    unfit[:w] = unfit[n - w :] = True
    for k in range(n - 1):
        deeper, broken = ranges[k + 1] - ranges[k], steps[k] > 16.0 * usual
        if not broken and abs(deeper) <= config.gap:
            continue
        unfit[max(k + 1 - w, 0) : k + 1 + w] = True
        if not broken:
            rim[k if deeper > 0 else k + 1] = True
    for k in range(1, n - 1):
        if min(abs(ranges[k - 1] - ranges[k]), abs(ranges[k + 1] - ranges[k])) > config.grazing * ranges[k]:
            unfit[k], rim[k] = True, False
    return unfit, rim


def features_slowly(xyz, config):
    """Return edges, planes, map edges and map planes of one line as places along it."""
    n, w = len(xyz), config.window
    if n < 2 * w + 1:
        return [], [], [], []
    ranges, (unfit, rim), taken = np.linalg.norm(xyz, axis=1), unfit_slowly(xyz, config), np.zeros(n, bool)
    offset = offsets_slowly(xyz, w)
    noise = 3.0 * config.range_noise
    flat = [
        not unfit[k] and not rim[k] and (offset[k] <= noise or offset[k] < config.plane_curvature * ranges[k])
        for k in range(n)
    ]
    edges, planes, map_edges = [], [], []
    regions = max((n + config.region // 2) // config.region, 1)

    def pick(candidates, most):
        picked = []
        for _, k in sorted(candidates)[: 4 * most]:
            if len(picked) < most and not taken[k]:
                picked.append(k)
                taken[max(k - w, 0) : k + w + 1] = True
        return picked

    for r in range(regions):
        span = range(r * n // regions, (r + 1) * n // regions)
        corners = [(-ranges[k], k) for k in span if rim[k] and not taken[k]]
        free = [k for k in span if not (unfit[k] or rim[k] or taken[k])]
        sharp = [k for k in free if offset[k] > noise and offset[k] / ranges[k] > config.edge_curvature]
        corners += [(-offset[k], k) for k in sharp]
        flats = [(offset[k], k) for k in free if k not in sharp and flat[k]]
        found = pick(corners, config.map_edges)
        edges += found[: config.edges]
        map_edges += found
        planes += pick(flats, config.planes)
    map_planes, waiting = [], config.map_stride
    for k in range(w, n - w):
        waiting += 1
        if waiting >= config.map_stride and flat[k]:
            map_planes.append(k)
            waiting = 0
    return edges, planes, map_edges, map_planes


SHIFT = 0.381966  # of the cubes, in edges


def means_slowly(points, voxel, max_points):
    """Return {cube: (mean, count)} of points in the order in which they come."""
    cells = {}
    for p in points:
        mean, count = cells.get(key := tuple(np.floor(p / voxel + SHIFT).astype(int)), (np.zeros(3), 0))
        if count < max_points:
            cells[key] = (mean + (p - mean) / (count + 1), count + 1)
    return cells


def match_slowly(cells, query, sigma, *, edges, neighbours, reach, max_thickness, min_spread):
    """Return axis, point, variance and tilt of the line or plane near a query, None where there is none."""
    near = sorted((np.linalg.norm(mean - query), tuple(mean), count) for mean, count in cells.values())[:neighbours]
    near = [one for one in near if one[0] <= reach]
    if len(near) < (3 if edges else 5):
        return None
    at = np.array([mean for _, mean, _ in near])
    w = np.minimum([count for *_, count in near], 10.0)
    centre = w @ at / w.sum()
    values, vectors = np.linalg.eigh((w[:, None] * (at - centre)).T @ (at - centre) / w.sum())
    across, along, axis = (values[1], values[2], vectors[:, 2]) if edges else (values[0], values[1], vectors[:, 0])
    if across > max_thickness**2 or along < min_spread**2 or along < 9.0 * across:
        return None
    free = max(len(near) - (2 if edges else 3), 1)
    variance = max(across / free, sigma**2 / w.sum())
    tilt = variance / along
    d = centre - query
    aside = (axis @ d) ** 2 if edges else d @ d - (axis @ d) ** 2
    return axis, centre, variance + tilt * aside, tilt


def sums_slowly(matches, points, T, *, edges, gate, kernel, sigma):
    """Return information, gradient and feigned information of matches, each as `match_slowly` returns it."""
    H, b, F = np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6))
    R, t = T[:3, :3], T[:3, 3]
    for p, match in zip(points.astype(np.float64), matches, strict=True):
        if match is None:
            continue
        axis, centre, variance, tilt = match
        across = np.linalg.svd(axis[None])[2][1:]
        normals = across if edges else axis[None]
        r = normals @ (R @ p + t - centre)
        if r @ r > gate**2:
            continue

        def row(n, p=p):
            return np.concatenate([np.cross(p, R.T @ n), n])

        w = (kernel**2 / (kernel**2 + r @ r)) ** 2 / (sigma**2 + variance)
        for n, e in zip(normals, r, strict=True):
            H += w * np.outer(row(n), row(n))
            b += w * e * row(n)
        for n in [axis, axis] if edges else across:
            F += w * tilt * np.outer(row(n), row(n))
    return H, b, F
