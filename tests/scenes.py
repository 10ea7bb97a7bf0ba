"""Small clouds with known shapes, for registration."""

import numpy as np

from heliograph.lie import se3, so3


def patch(rng, centre, u, v, count):
    """Points spread evenly over the parallelogram centre + a u + b v, a and b in [-1, 1]."""
    a, b = rng.uniform(-1.0, 1.0, (2, count, 1))
    return np.asarray(centre) + a * np.asarray(u, dtype=float) + b * np.asarray(v, dtype=float)


def corner_room(rng, density=60, noise=0.01):
    """A room of 8 m by 6 m by 3 m with a bay, a pillar and a table: all is seen, and no turn looks alike."""
    parts = [
        ((0, 0, -1.5), (4, 0, 0), (0, 3, 0), 24),
        ((0, 0, 1.5), (4, 0, 0), (0, 3, 0), 24),
        ((4, 0, 0), (0, 3, 0), (0, 0, 1.5), 9),
        ((-4, -1, 0), (0, 2, 0), (0, 0, 1.5), 6),
        ((-2.5, 2, 0), (1.5, -1, 0), (0, 0, 1.5), 6),
        ((0, 3, 0), (4, 0, 0), (0, 0, 1.5), 12),
        ((0, -3, 0), (4, 0, 0), (0, 0, 1.5), 12),
        ((2.0, 1.2, 0), (0, 0.4, 0), (0, 0, 1.5), 3),
        ((-1.5, -1.0, -0.7), (0.8, 0, 0), (0, 0.6, 0), 2),
    ]
    cloud = np.concatenate([patch(rng, c, u, v, int(area * density)) for c, u, v, area in parts])
    return (cloud + noise * rng.normal(size=cloud.shape)).astype(np.float32)


def corridor(rng, count=4000, noise=0.01, half=12.0):
    """Floor, ceiling and two walls along x."""
    x = (half, 0, 0)
    parts = [((0, 1, 0), (0, 0, 1.2)), ((0, -1, 0), (0, 0, 1.2)), ((0, 0, 1.2), (0, 1, 0)), ((0, 0, -1.2), (0, 1, 0))]
    cloud = np.concatenate([patch(rng, c, x, v, count // 4) for c, v in parts])
    return cloud + noise * rng.normal(size=cloud.shape)


def tunnel(rng, count=4000, noise=0.01, half=12.0, radius=2.5):
    """A round tube along x: blind along x and about x."""
    angle, x = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(-half, half, count)
    cloud = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return cloud + noise * rng.normal(size=cloud.shape)


def plane(rng, count=4000, noise=0.01):
    """The ground: blind along x and y and about z."""
    cloud = patch(rng, (0, 0, -1.5), (8, 0, 0), (0, 8, 0), count)
    return cloud + noise * rng.normal(size=cloud.shape)


def sphere(rng, count=4000, noise=0.01, centre=(3.0, -2.0, 1.0), radius=2.5):
    """A ball off the origin: blind about every axis through its centre."""
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return np.asarray(centre) + radius * n + noise * rng.normal(size=n.shape)


def moved(cloud, T):
    """The same points in a frame whose pose in theirs is T."""
    return se3.act(se3.inverse(T), np.asarray(cloud, dtype=np.float64)).astype(np.float32)


def random_motion(rng, distance, angle):
    """A motion of exactly this distance [m] and angle [rad]."""
    a, d = rng.normal(size=(2, 3))
    T = np.eye(4)
    T[:3, :3] = so3.exp(angle * a / np.linalg.norm(a))
    T[:3, 3] = distance * d / np.linalg.norm(d)
    return T
