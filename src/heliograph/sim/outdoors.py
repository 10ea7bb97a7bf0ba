"""Places without walls: a forest with undergrowth, and rough ground strewn with stones."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.lie import so3
from heliograph.sim.trajectory import Course
from heliograph.sim.world import Primitive, Surface, box, cylinder, rectangle

__all__ = ["forest_world", "ground_course", "ground_height", "rough_world"]

_GRASS = Surface(reflectivity=0.3, contrast=0.4, period=0.5)
_LEAVES = Surface(reflectivity=0.45, contrast=0.5, period=0.1)
_BARK = Surface(reflectivity=0.35, contrast=0.4, period=0.15)
_STONE = Surface(reflectivity=0.4, contrast=0.3, period=0.3)

Height = Callable[[ArrayLike, ArrayLike], NDArray[np.float64]]


def ground_height(rng: np.random.Generator, lengths: tuple[float, float], amplitude: float) -> Height:
    """Return a height over x and y [m]: eight waves of ``lengths`` [m], in all ``amplitude`` [m] RMS."""
    count = 8
    heading, phase = rng.uniform(0.0, np.pi, count), rng.uniform(0.0, 7.0, count)
    k = 2.0 * np.pi / rng.uniform(*lengths, count) * np.array([np.cos(heading), np.sin(heading)])
    size = amplitude * np.sqrt(2.0 / count)

    def at(x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(size * np.sin(np.multiply.outer(x, k[0]) + np.multiply.outer(y, k[1]) + phase).sum(axis=-1))

    return at


def _ground(height: Height, half: float, edge: float) -> Iterator[Primitive]:
    """Yield facets of ``edge`` metres that follow the height over a square, each a little larger than its place."""
    for x in np.arange(-half + edge / 2.0, half, edge):
        for y in np.arange(-half + edge / 2.0, half, edge):
            slopes = [height(x + dx, y + dy) - height(x - dx, y - dy) for dx, dy in ((edge / 2, 0.0), (0.0, edge / 2))]
            R = so3.from_two_vectors(np.array([0.0, 0.0, 1.0]), np.array([*(-np.array(slopes) / edge), 1.0]))
            yield rectangle((x, y, float(height(x, y))), (1.08 * edge, 1.08 * edge), R, _GRASS)


def _clear(x: float, y: float, room: float) -> bool:
    """Whether a place keeps away from the way, which is a rounded square of 9 m half a side."""
    return abs(max(abs(x), abs(y)) - 9.0) > room


def forest_world(rng: np.random.Generator, height: Height) -> Iterator[Primitive]:
    """Yield trunks that lean a little, thin branches, and bushes of small leaves on uneven ground."""
    yield from _ground(height, 50.0, 2.0)
    for x, y in rng.uniform(-48.0, 48.0, (420, 2)):
        if not _clear(x, y, 1.3):
            continue
        z, tall = float(height(x, y)), rng.uniform(5.0, 11.0)
        lean = rng.normal(0.0, 0.05, 2)
        R = so3.from_rpy(lean[0], lean[1], 0.0)
        yield cylinder((x, y, z + tall / 2.0), rng.uniform(0.07, 0.3), tall, R, _BARK)
        for _ in range(4):  # branches of two to four centimetres
            R = so3.from_rpy(rng.uniform(0.8, 1.6), 0.0, rng.uniform(0.0, 6.28))
            out = R @ np.array([0.0, 0.0, 0.9])
            yield cylinder((x + out[0], y + out[1], z + rng.uniform(1.8, 4.5)), rng.uniform(0.01, 0.02), 1.8, R, _BARK)
    for x, y in rng.uniform(-30.0, 30.0, (110, 2)):
        if not _clear(x, y, 2.0):
            continue
        for p in rng.normal(0.0, (0.5, 0.5, 0.25), (14, 3)):
            R = so3.from_rpy(*rng.uniform(-1.5, 1.5, 3))
            yield box((x + p[0], y + p[1], height(x, y) + 0.5 + p[2]), rng.uniform(0.03, 0.22, 3), R, _LEAVES)


def rough_world(rng: np.random.Generator, height: Height) -> Iterator[Primitive]:
    """Yield ground of short waves, strewn with stones, and a few boulders farther off."""
    yield from _ground(height, 40.0, 1.0)
    for x, y in rng.uniform(-30.0, 30.0, (700, 2)):
        if _clear(x, y, 0.8):
            R = so3.from_rpy(*rng.uniform(-1.5, 1.5, 3))
            yield box((x, y, float(height(x, y))), rng.uniform(0.15, 0.7, 3), R, _STONE)
    for x, y in rng.uniform(-38.0, 38.0, (25, 2)):
        if _clear(x, y, 5.0):
            R = so3.from_rpy(*rng.uniform(-1.5, 1.5, 3))
            yield box((x, y, float(height(x, y)) + 0.5), rng.uniform(1.2, 3.0, 3), R, _STONE)


def ground_course(height: Height, *, eye: float) -> Course:
    """Return a loop of some 66 m that follows the ground at a height of ``eye`` [m], smoothly."""
    corners = [(0.0, -9.0), (9.0, -9.0), (9.0, 0.0), (9.0, 9.0), (0.0, 9.0), (-9.0, 9.0), (-9.0, 0.0), (-9.0, -9.0)]
    return Course(waypoints=np.array([(x, y, float(height(x, y)) + eye) for x, y in corners]), corner=2.0)
