"""Slow, obvious twins of the native point decoder: one point at a time."""

import math

import numpy as np


def decode_slowly(columns):
    """Return points, indices, times and rings of the points that are finite and not all zero, as lists."""
    flat = {name: column.reshape(-1) for name, column in columns.items()}
    points, kept = [], []
    for i in range(flat["x"].size):
        with np.errstate(over="ignore"):
            point = [np.float32(flat[axis][i]) for axis in "xyz"]
        if all(math.isfinite(v) for v in point) and any(v != 0 for v in point):
            points.append(point)
            kept.append(i)
    taken = {name: [column[i] for i in kept] for name, column in flat.items()}
    return points, kept, taken


def offsets_slowly(times, first, ns_per_unit, longest_ns):
    """Return the offset [ns] of each time, None where it is not within the sweep."""
    found = []
    for time in times:
        relative = (float(time) - first) * ns_per_unit
        found.append(round(relative) if math.isfinite(relative) and abs(relative) <= longest_ns else None)
    return found
