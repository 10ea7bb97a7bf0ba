"""Slow, obvious twin of the native ray caster: every ray against every face of every primitive."""

import numpy as np


@np.errstate(divide="ignore", invalid="ignore")
def cast_slowly(world, directions, T_world_sensor, min_range, max_range):
    """Return range, brightness and primitive of each ray, as `heliograph.sim.world.SimulatedWorld.cast` does."""
    rows, columns, _ = directions.shape
    d_world = np.einsum("cij,rcj->rci", T_world_sensor[:, :3, :3], directions)
    o_world = np.broadcast_to(T_world_sensor[:, :3, 3], d_world.shape)
    ranges = np.full((rows, columns), np.inf)
    brightness = np.zeros((rows, columns), np.float32)
    ids = np.full((rows, columns), -1, np.int32)
    for index, p in enumerate(world.primitives):
        o = (o_world - p.center) @ p.R_world_local
        d = d_world @ p.R_world_local
        for t, cosine in hits(p, o, d):
            t = np.where((t >= min_range) & (t <= max_range), t, np.inf)
            nearer = t < ranges
            at = o + np.where(nearer, t, 0.0)[..., None] * d
            shade = p.surface.reflectivity * (1.0 - p.surface.contrast * checker(at, p.surface.period))
            brightness = np.where(nearer, shade * np.abs(cosine), brightness)
            ids = np.where(nearer, index, ids)
            ranges = np.where(nearer, t, ranges)
    return np.where(ids >= 0, ranges, 0.0), brightness.astype(np.float32), ids.astype(np.int32)


def checker(local, period):
    return np.floor(local / period + 0.25).sum(axis=-1).astype(np.int64) % 2


def hits(p, o, d):
    """Yield the distance to each face along the ray (NaN or infinite where there is none), and the cosine there."""
    if p.shape == "cylinder":
        yield from cylinder_hits(p.half, o, d)
        return
    for axis in range(3) if p.shape == "box" else [2]:
        for side in (-1.0, 1.0) if p.shape == "box" else [0.0]:
            t = (side * p.half[axis] - o[..., axis]) / d[..., axis]
            at = o + t[..., None] * d
            inside = [np.abs(at[..., other]) <= p.half[other] for other in range(3) if other != axis]
            yield np.where(inside[0] & inside[1], t, np.inf), d[..., axis]


def cylinder_hits(half, o, d):
    radius, height = half[0], half[2]
    a = (d[..., :2] ** 2).sum(-1)
    b = 2.0 * (o[..., :2] * d[..., :2]).sum(-1)
    c = (o[..., :2] ** 2).sum(-1) - radius**2
    root = np.sqrt(b**2 - 4.0 * a * c)
    for sign in (-1.0, 1.0):
        t = (-b + sign * root) / (2.0 * a)
        at = o + t[..., None] * d
        normal = at[..., :2] / radius
        yield np.where(np.abs(at[..., 2]) <= height, t, np.inf), (normal * d[..., :2]).sum(-1)
    for side in (-height, height):
        t = (side - o[..., 2]) / d[..., 2]
        at = o + t[..., None] * d
        yield np.where((at[..., :2] ** 2).sum(-1) <= radius**2, t, np.inf), d[..., 2]
