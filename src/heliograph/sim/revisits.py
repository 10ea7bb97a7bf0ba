"""Places for back-ends: a campus in a figure of eight, a loop in a city, a building that repeats itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from heliograph.lie import so3
from heliograph.sim.trajectory import Course
from heliograph.sim.world import Primitive, Surface, box, cylinder, rectangle

__all__ = [
    "STOREYS_HEIGHT",
    "STOREYS_LENGTH",
    "STOREYS_PITCH",
    "campus_course",
    "campus_world",
    "city_course",
    "city_world",
    "storeys_course",
    "storeys_world",
]

_ASPHALT = Surface(reflectivity=0.18, contrast=0.3, period=1.1)
_BRICK = Surface(reflectivity=0.4, contrast=0.35, period=0.6)
_STEEL = Surface(reflectivity=0.45, contrast=0.5, period=0.25)
_WOOD = Surface(reflectivity=0.5, contrast=0.3, period=0.3)
_PANEL = Surface(reflectivity=0.6, contrast=0.2, period=1.2)
_LEVEL = np.eye(3)

# The campus: streets around two blocks of 150 m by 120 m that share the street between them.
_WEST, _MIDDLE, _EAST, _SOUTH, _NORTH = 0.0, 150.0, 300.0, 0.0, 120.0
_EYE = 1.6

# The building: two equal storeys, each with three equal corridors along x between two halls.
STOREYS_LENGTH, STOREYS_PITCH, STOREYS_HEIGHT = 40.0, 10.0, 3.6
_WIDTH = 2.4
_HALL = 7.0


def campus_course() -> Course:
    """Return a way of about 1.1 km that walks the street in the middle twice and ends 45 m past its start."""
    m, e, w, s, n = _MIDDLE, _EAST, _WEST, _SOUTH, _NORTH
    corners = [(75.0, s), (m, s), (m, n), (e, n), (e, s), (m, s), (m, n), (w, n), (w, s), (120.0, s)]
    return Course(waypoints=np.array([(x, y, _EYE) for x, y in corners]), corner=5.0, closed=False)


def campus_world(rng: np.random.Generator) -> Iterator[Primitive]:
    """Yield houses of random size on both sides of all streets, poles, trees and parked cars."""
    yield rectangle((150.0, 60.0, 0.0), (520.0, 340.0), _LEVEL, _ASPHALT)
    for x in (_WEST, _MIDDLE, _EAST):
        yield from _street(rng, (x, _SOUTH), (x, _NORTH))
    for y in (_SOUTH, _NORTH):
        for x in (_WEST, _MIDDLE):
            yield from _street(rng, (x, y), (x + 150.0, y))


_CITY = ((0.0, 0.0), (800.0, 0.0), (800.0, 400.0), (400.0, 400.0), (400.0, 700.0), (0.0, 700.0))


def city_course() -> Course:
    """Return a closed way of 3 km with an inner corner, driven once."""
    x, y, eye = 60.0, 0.0, 1.8
    return Course(waypoints=np.array([(x, y, eye), *((x, y, eye) for x, y in (*_CITY[1:], _CITY[0]))]), corner=12.0)


def city_world(rng: np.random.Generator) -> Iterator[Primitive]:
    """Yield houses on both sides of the way, poles, trees and parked cars."""
    yield rectangle((400.0, 350.0, 0.0), (1100.0, 1000.0), _LEVEL, _ASPHALT)
    for start, end in zip(_CITY, (*_CITY[1:], _CITY[0]), strict=True):
        yield from _street(rng, start, end)


def _street(rng: np.random.Generator, start: tuple[float, float], end: tuple[float, float]) -> Iterator[Primitive]:
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    left = np.array([-along[1], along[0]])
    turn = float(np.arctan2(along[1], along[0]))
    for side in (-1.0, 1.0):
        at = 14.0
        while at < length - 22.0:  # the corners stay clear
            width, depth, height = rng.uniform((8.0, 6.0, 4.0), (18.0, 12.0, 12.0))
            x, y = a + along * (at + width / 2.0) + left * side * (8.0 + rng.uniform(0.0, 3.0) + depth / 2.0)
            yield _house((float(x), float(y)), (width, depth, height), turn)
            at += width + rng.uniform(2.0, 7.0)
        for at in np.arange(10.0, length, 24.0):
            x, y = a + along * (at + rng.normal(0.0, 2.0)) + left * side * 5.4
            yield cylinder((x, y, 3.0), 0.1, 6.0, None, _STEEL)
        for at in np.arange(16.0, length - 12.0, 10.0):
            if rng.random() < 0.5:
                x, y = a + along * at + left * side * 4.2
                size = rng.uniform((3.8, 1.7, 1.4), (5.0, 1.9, 1.9))
                yield _house((float(x), float(y)), tuple(size.tolist()), turn + rng.normal(0.0, 0.03), _PANEL)
            elif rng.random() < 0.4:
                x, y = a + along * at + left * side * 6.4
                yield cylinder((x, y, 1.5), 0.2, 3.0, None, _WOOD)
                yield box((x, y, 4.2), rng.uniform(1.8, 3.0, 3), _yaw(rng.uniform(-0.5, 0.5)), _WOOD)


def _house(
    at: tuple[float, float], size: tuple[float, ...], turn: float, surface: Surface = _BRICK, z: float = 0.0
) -> Primitive:
    return box((at[0], at[1], z + size[2] / 2.0), size, _yaw(turn), surface)


def _yaw(angle: float) -> NDArray[np.float64]:
    return so3.from_rpy(0.0, 0.0, angle)


def storeys_course() -> Course:
    """Return a way through all corridors of both storeys, over the ramp between them, and around the building twice."""
    low, high = _EYE, _EYE + STOREYS_HEIGHT
    west, east = -_HALL / 2.0, STOREYS_LENGTH + _HALL / 2.0
    y0, y1, y2 = 0.0, STOREYS_PITCH, 2.0 * STOREYS_PITCH
    inside = [(20.0, y0), (east, y0), (east, y1), (west, y1), (west, y2), (east, y2)]
    lower = [(x, y, low) for x, y in inside]
    ramp = [(east + 4.0, y2, low), (east + 4.0, y0 - 4.0, high), (east, y0 - 4.0, high)]
    upper = [(east, y0, high), (west, y0, high), (west, y1, high), (east, y1, high), (east, y2, high), (west, y2, high)]
    back = [(west - 4.0, y2, high), (west - 4.0, y0, low), (west, y0, low), (20.0, y0, low), (30.0, y0, low)]
    return Course(waypoints=np.array([*lower, *ramp, *upper, *back]), corner=1.2, closed=False)


def storeys_world(rng: np.random.Generator) -> Iterator[Primitive]:
    """Yield two storeys that are alike to the last niche; only the ramps outside tell where one is."""
    doors = [(float(x), side) for x, side in zip(rng.uniform(4.0, 36.0, 6), rng.choice([-1.0, 1.0], 6), strict=True)]
    outer = (-_HALL, STOREYS_LENGTH + _HALL)
    middle, span = (outer[0] + outer[1]) / 2.0, outer[1] - outer[0]
    yield rectangle((middle, STOREYS_PITCH, -0.01), (span + 90.0, 110.0), _LEVEL, _ASPHALT)
    for storey in (0, 1):
        z = storey * STOREYS_HEIGHT
        for floor in (z, z + STOREYS_HEIGHT - 0.3):
            yield box((middle, STOREYS_PITCH, floor - 0.05), (span, 2.0 * STOREYS_PITCH + 12.0, 0.1), None, _PANEL)
        for k in range(3):
            y = k * STOREYS_PITCH
            for side in (-1.0, 1.0):
                wall = y + side * (_WIDTH / 2.0 + 0.1)
                yield box((STOREYS_LENGTH / 2.0, wall, z + 1.65), (STOREYS_LENGTH, 0.2, 3.3), None, _PANEL)
            for x, side in doors:  # the same in each corridor
                yield box((x, y + side * _WIDTH / 2.0, z + 1.05), (0.95, 0.12, 2.1), None, _WOOD)
        yield box((-1.0, -_WIDTH - 1.2, z + 1.0), (0.6, 1.5, 2.0), None, _STEEL)
        yield box((STOREYS_LENGTH + 1.0, 2.0 * STOREYS_PITCH + 3.0, z + 1.0), (0.6, 1.5, 2.0), None, _STEEL)
    for x in (STOREYS_LENGTH + _HALL + 3.0, -_HALL - 3.0):
        slope = np.arctan2(STOREYS_HEIGHT, 2.0 * STOREYS_PITCH + 4.0)
        R = so3.from_rpy(-slope if x > 0.0 else slope, 0.0, 0.0)
        yield rectangle((x, STOREYS_PITCH - 2.0, STOREYS_HEIGHT / 2.0), (5.0, 2.0 * STOREYS_PITCH + 4.0), R, _ASPHALT)
    for _ in range(30):
        angle, reach = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(45.0, 70.0)
        at = (20.0 + reach * float(np.cos(angle)), STOREYS_PITCH + reach * float(np.sin(angle)))
        yield _house(at, tuple(rng.uniform((4.0, 4.0, 3.0), (10.0, 9.0, 9.0)).tolist()), float(rng.uniform(0.0, 3.0)))
