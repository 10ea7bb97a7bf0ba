"""People who walk through a simulated recording: upright cylinders that hide what is behind them."""

from dataclasses import dataclass, replace

import numpy as np

from heliograph.data import Scan

RADIUS, HEIGHT = 0.25, 1.75


@dataclass(frozen=True)
class Walker:
    """Walks to and fro between two places of the world, `speed` m/s, on the ground at `floor`."""

    a: tuple[float, float]
    b: tuple[float, float]
    speed: float = 1.2
    floor: float = 0.0

    def at(self, seconds):
        """Position (N, 2) at times (N,) [s]."""
        a, b = np.array(self.a), np.array(self.b)
        length = float(np.linalg.norm(b - a))
        s = np.abs((self.speed * seconds + length) % (2.0 * length) - length)
        return a + (s / length)[:, None] * (b - a)


def with_walkers(simulation, walkers, *, noise=0.01, seed=0):
    """The simulation's records, with people in its scans."""
    rng = np.random.default_rng([11, seed])
    began = None
    for record in simulation:
        if not isinstance(record, Scan):
            yield record
            continue
        began = record.stamp_ns if began is None else began
        stamps = record.stamp_ns + record.offsets_ns.astype(np.int64)
        ticks, which = np.unique(stamps, return_inverse=True)
        T = (simulation.truth.pose(ticks) @ simulation.rig.T_imu_lidar)[which]
        p = record.points.astype(np.float64)
        ranges = np.linalg.norm(p, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            ways = np.einsum("nij,nj->ni", T[:, :3, :3], p / ranges[:, None])
        for walker in walkers:
            hit = _hit(T[:, :3, 3], ways, walker.at(1e-9 * (stamps - began)), walker.floor)
            nearer = np.isfinite(hit) & (hit > 0.3) & (hit < ranges)
            measured = hit[nearer] + rng.normal(0.0, noise, int(nearer.sum()))
            p[nearer] *= (measured / ranges[nearer])[:, None]
            ranges[nearer] = measured
        yield replace(record, points=p.astype(np.float32))


def _hit(origins, ways, centres, floor):
    """Distance (N,) along rays to an upright cylinder's side, infinite where they miss it."""
    o, d = origins[:, :2] - centres, ways[:, :2]
    a, b, c = (d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - RADIUS**2
    with np.errstate(invalid="ignore", divide="ignore"):
        t = (-b - np.sqrt(b * b - a * c)) / a
        z = origins[:, 2] + t * ways[:, 2]
        return np.where((t > 0.0) & (z > floor) & (z < floor + HEIGHT), t, np.inf)
