"""The places that scenarios happen in: a world that varies a little with the seed, and a course through it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.lie import so3
from heliograph.sim.movers import Mover
from heliograph.sim.outdoors import forest_world, ground_course, ground_height, rough_world
from heliograph.sim.revisits import campus_course, campus_world, city_course, city_world, storeys_course, storeys_world
from heliograph.sim.trajectory import Course
from heliograph.sim.world import Primitive, SimulatedWorld, Surface, box, cylinder, rectangle

__all__ = ["PLACES", "Place"]

_CONCRETE = Surface(reflectivity=0.35, contrast=0.25, period=0.8)
_ASPHALT = Surface(reflectivity=0.18, contrast=0.3, period=1.1)
_PANEL = Surface(reflectivity=0.6, contrast=0.2, period=1.2)
_STEEL = Surface(reflectivity=0.45, contrast=0.5, period=0.25)
_BRICK = Surface(reflectivity=0.4, contrast=0.35, period=0.6)
_WOOD = Surface(reflectivity=0.5, contrast=0.3, period=0.3)
_GRASS = Surface(reflectivity=0.3, contrast=0.4, period=0.5)

_LEVEL = np.eye(3)
_FACES_X = so3.from_rpy(np.pi / 2, 0.0, np.pi / 2)  # local x along world y, local y up, normal along world x
_FACES_Y = so3.from_rpy(np.pi / 2, 0.0, 0.0)  # local x along world x, local y up, normal along world -y


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A world and the course walked in it.

    Parameters
    ----------
    world : SimulatedWorld
        What the LiDAR sees.
    course : Course
        Way of the IMU [m].
    movers : tuple of Mover
        What moves in it.
    """

    world: SimulatedWorld
    course: Course
    movers: tuple[Mover, ...] = ()


def _yaw(angle: float) -> NDArray[np.float64]:
    return so3.from_rpy(0.0, 0.0, angle)


def _standing(x: float, y: float, size: ArrayLike, surface: Surface, *, yaw: float = 0.0, z: float = 0.0) -> Primitive:
    """Return a box that stands on height ``z``."""
    size = np.asarray(size, dtype=np.float64)
    return box((x, y, z + size[2] / 2.0), size, _yaw(yaw), surface)


def _carton(rng: np.random.Generator, x: float, y: float, z: float, largest: ArrayLike) -> Primitive:
    """Return a box of random size and shade that stands on ``z``, slightly turned."""
    size = np.asarray(largest) * rng.uniform(0.55, 1.0, 3)
    shade = Surface(reflectivity=rng.uniform(0.25, 0.85), contrast=0.25, period=rng.uniform(0.15, 0.5))
    return _standing(x, y, size, shade, yaw=rng.normal(0.0, 0.05), z=z)


def _shelf(rng: np.random.Generator, x0: float, x1: float, y: float, fill: float) -> Iterator[Primitive]:
    """Yield a rack along x with three decks, uprights, and cartons on a random part of its places."""
    depth, bay, decks = 1.1, 2.7, (0.12, 1.55, 3.0)
    bays = round((x1 - x0) / bay)
    width = (x1 - x0) / bays
    for z in decks:
        yield box(((x0 + x1) / 2.0, y, z), (x1 - x0, depth, 0.08), None, _STEEL)
    for i in range(bays + 1):
        for side in (-1.0, 1.0):
            yield _standing(x0 + i * width, y + side * (depth / 2.0 - 0.05), (0.1, 0.1, 4.3), _STEEL)
    for i in range(bays):
        for z in decks:
            for place in (0.28, 0.72):
                if rng.random() < fill:
                    x = x0 + (i + place) * width + rng.normal(0.0, 0.05)
                    yield _carton(rng, x, y + rng.normal(0.0, 0.05), z + 0.04, (1.15, 1.0, 1.25))


def _hall(rng: np.random.Generator) -> Iterator[Primitive]:
    """Yield the warehouse proper: x 0 to 42, y 0 to 24, two gates in its east wall."""
    height = 7.0
    yield rectangle((21.0, 12.0, 0.0), (42.0, 24.0), _LEVEL, _CONCRETE)
    yield rectangle((21.0, 12.0, height), (42.0, 24.0), _LEVEL, _PANEL)
    yield rectangle((0.0, 12.0, height / 2.0), (24.0, height), _FACES_X, _PANEL)
    for y in (0.0, 24.0):
        yield rectangle((21.0, y, height / 2.0), (42.0, height), _FACES_Y, _PANEL)
    for y0, y1 in ((0.0, 4.0), (8.0, 16.0), (20.0, 24.0)):
        yield box((42.1, (y0 + y1) / 2.0, height / 2.0), (0.2, y1 - y0, height), None, _PANEL)
    for y in (6.0, 18.0):
        yield box((42.1, y, 5.75), (0.2, 4.0, 2.5), None, _PANEL)
    for x in np.arange(6.0, 42.0, 6.0):
        yield box((x, 12.0, height - 0.25), (0.2, 24.0, 0.5), None, _STEEL)
        for y in (0.15, 23.85):
            yield _standing(x, y, (0.3, 0.3, height), _STEEL)
    for x, y in ((2.0, 9.2), (2.0, 15.0), (21.7, 9.0), (38.5, 9.0), (38.5, 15.0), (20.0, 21.0), (20.0, 3.0)):
        yield cylinder((x, y, height / 2.0), 0.22, height, None, _CONCRETE)
    for y, fill in ((2.9, 0.7), (9.0, 0.65), (15.0, 0.65), (21.1, 0.7)):
        for x0, x1 in ((7.0, 17.8), (22.2, 35.7)):
            yield from _shelf(rng, x0, x1, y, fill * rng.uniform(0.85, 1.15))
    for _ in range(14):  # pallets in the corners and before the gates, clear of the way
        x, y = rng.uniform(36.8, 40.8), rng.choice([1.6, 3.2, 9.4, 10.9, 12.6, 14.4, 20.9, 22.4])
        yield _carton(rng, x, y + rng.normal(0.0, 0.1), 0.0, (1.2, 1.1, 1.9))
    for y in rng.uniform(15.5, 22.5, 4):
        yield _carton(rng, rng.uniform(0.9, 4.5), y, 0.0, (1.3, 1.3, 2.0))


def _ramp_height(x: float) -> float:
    """Height of the yard's ground: level at the gates, then a rise of 5 %, level again."""
    return float(np.clip((x - 48.0) * 0.05, 0.0, 0.5))


def _yard(rng: np.random.Generator) -> Iterator[Primitive]:
    """Yield the yard east of the hall: a ramp, containers, a facade, a bank, poles and trees."""
    slope = float(np.arctan(0.05))
    yield rectangle((45.0, 12.0, 0.0), (6.0, 90.0), _LEVEL, _ASPHALT)
    yield rectangle((53.0, 12.0, 0.25), (float(np.hypot(10.0, 0.5)), 90.0), so3.from_rpy(0.0, -slope, 0.0), _ASPHALT)
    yield rectangle((78.0, 12.0, 0.5), (40.0, 90.0), _LEVEL, _ASPHALT)
    yield box((91.0, 12.0, 6.5), (10.0, 46.0, 12.0), None, _BRICK)
    for y in np.arange(-7.0, 33.0, 4.0):  # window reveals and a cornice break the facade's plane
        for z in (2.4, 6.0, 9.6):
            yield box((85.95, y, z), (0.3, 1.4, 1.8), None, Surface(reflectivity=0.75, contrast=0.1, period=0.7))
    yield box((85.8, 12.0, 12.3), (0.8, 46.4, 0.4), None, _CONCRETE)
    yield rectangle((66.0, 41.0, 2.1), (48.0, 8.0), so3.from_rpy(np.radians(24.0), 0.0, 0.0), _GRASS)
    yield rectangle((66.0, -14.0, 1.6), (48.0, 5.0), so3.from_rpy(np.radians(-31.0), 0.0, 0.0), _GRASS)
    for x, y, turn in ((51.0, 0.0, 0.1), (58.5, -3.0, -0.2), (77.0, 1.0, 1.5), (54.0, 25.0, 0.15), (63.0, 27.0, -0.3)):
        if rng.random() < 0.85:
            yaw = turn + rng.normal(0.0, 0.15)
            shade = Surface(reflectivity=rng.uniform(0.3, 0.7), contrast=0.3, period=0.28)
            yield _standing(x + rng.normal(0.0, 0.4), y, (6.06, 2.44, 2.59), shade, yaw=yaw, z=_ramp_height(x))
            if rng.random() < 0.4:
                yield _standing(x, y, (6.06, 2.44, 2.59), _STEEL, yaw=yaw, z=_ramp_height(x) + 2.59)
    for x, y in ((54.0, 11.0), (60.0, 13.0), (63.5, 10.5)):  # an island of goods inside the loop
        yield _carton(rng, x, y, _ramp_height(x), (2.4, 1.4, 2.2))
    for x, y in ((46.0, -2.0), (46.0, 26.0), (62.0, -7.0), (73.0, 22.0), (73.0, 2.5), (57.5, 20.8)):
        yield cylinder((x, y, _ramp_height(x) + 3.5), 0.11, 7.0, None, _STEEL)
    for x, y in rng.uniform((50.0, 30.5), (82.0, 35.0), (5, 2)):
        yield cylinder((x, y, 1.6), 0.2, 3.2, None, _WOOD)
        yield box((x, y, 4.2), rng.uniform(1.8, 2.8, 3), so3.from_rpy(*rng.uniform(-0.5, 0.5, 3)), _GRASS)


def warehouse(rng: np.random.Generator) -> Place:
    """Return a hall with racks and a yard; the lap of about 150 m passes through both and through two gates."""
    eye = 0.9
    corners = [(7.0, 6.0), (48.0, 6.0), (58.0, 6.0), (69.0, 6.0), (69.0, 18.0), (58.0, 18.0), (48.0, 18.0)]
    corners += [(20.0, 18.0), (20.0, 12.0), (4.0, 12.0), (4.0, 6.0)]
    waypoints = np.array([(x, y, _ramp_height(x) + eye) for x, y in corners])
    return Place(world=SimulatedWorld([*_hall(rng), *_yard(rng)]), course=Course(waypoints=waypoints, corner=2.0))


def warehouse_laps(rng: np.random.Generator) -> Place:
    """Return the warehouse with two laps, the second 0.5 m beside the first, and a bit of a third."""
    return _lapped(warehouse(rng))


def aisles(rng: np.random.Generator) -> Place:
    """Return the warehouse with a loop of about 40 m around one of its racks."""
    waypoints = np.array([(7.0, 6.0, 0.9), (20.0, 6.0, 0.9), (20.0, 12.0, 0.9), (4.0, 12.0, 0.9), (4.0, 6.0, 0.9)])
    return Place(world=warehouse(rng).world, course=Course(waypoints=waypoints, corner=1.6))


def aisle_laps(rng: np.random.Generator) -> Place:
    """Return the loop around one of the warehouse's racks walked twice, and a bit of a third time."""
    return _lapped(aisles(rng))


def _lapped(place: Place) -> Place:
    lap, beside = place.course.waypoints, np.array([0.4, 0.3, 0.0])
    way = np.vstack([lap, lap + beside, lap[:1] + beside + np.array([6.0, 0.0, 0.0])])
    return Place(world=place.world, course=Course(waypoints=way, corner=place.course.corner, closed=False))


def room(rng: np.random.Generator) -> Place:
    """Return a furnished room of 10 m by 7 m with a loop around its table."""
    primitives = [
        rectangle((5.0, 3.5, 0.0), (10.0, 7.0), _LEVEL, _WOOD),
        rectangle((5.0, 3.5, 2.8), (10.0, 7.0), _LEVEL, _PANEL),
        *(rectangle((x, 3.5, 1.4), (7.0, 2.8), _FACES_X, _PANEL) for x in (0.0, 10.0)),
        *(rectangle((5.0, y, 1.4), (10.0, 2.8), _FACES_Y, _PANEL) for y in (0.0, 7.0)),
        box((5.0, 3.5, 0.74), (2.6, 1.1, 0.05), None, _WOOD),
        *(_standing(5.0 + i * 1.2, 3.5 + j * 0.45, (0.07, 0.07, 0.72), _WOOD) for i in (-1, 1) for j in (-1, 1)),
        cylinder((8.9, 5.9, 1.4), 0.25, 2.8, None, _CONCRETE),
        _standing(0.35, 3.0, (0.6, 2.2, 0.8), _WOOD),
        _standing(3.0, 6.75, (2.2, 0.45, 2.0), _WOOD),
        _standing(9.7, 1.8, (0.5, 1.6, 1.6), _BRICK),
        _standing(5.5, 0.3, (3.0, 0.5, 1.0), _PANEL),
        box((5.0, 3.5, 2.7), (1.2, 0.3, 0.1), None, _PANEL),
    ]
    for x, y in ((4.4, 2.6), (5.6, 2.6), (4.4, 4.4), (5.7, 4.4)):
        primitives.append(_standing(x, y, (0.42, 0.42, 0.46), _WOOD, yaw=rng.uniform(-0.6, 0.6)))
    for x, y, z in (
        (0.35, 2.5, 0.8),
        (5.0, 0.3, 1.0),
        (6.2, 0.3, 1.0),
        (9.7, 1.6, 1.6),
        (0.5, 6.4, 0.0),
        (9.4, 0.5, 0.0),
    ):
        primitives.append(_carton(rng, x, y, z, (0.45, 0.35, 0.5)))
    waypoints = np.array([(5.0, 1.4, 1.4), (8.4, 1.4, 1.5), (8.2, 5.4, 1.3), (2.0, 5.5, 1.45), (1.7, 1.4, 1.35)])
    return Place(world=SimulatedWorld(primitives), course=Course(waypoints=waypoints, corner=1.1))


def level_room(rng: np.random.Generator) -> Place:
    """Return the room with a level loop around its table, as a ground robot drives it."""
    waypoints = np.array([(5.0, 1.5, 0.5), (8.3, 1.5, 0.5), (8.1, 5.3, 0.5), (2.0, 5.4, 0.5), (1.8, 1.5, 0.5)])
    return Place(world=room(rng).world, course=Course(waypoints=waypoints, corner=1.1))


def tunnel(rng: np.random.Generator) -> Place:
    """Return a straight tunnel of 160 m whose cross-section never changes; only a few niches tell where one is."""
    primitives = [
        rectangle((60.0, 0.0, 0.0), (160.0, 5.0), _LEVEL, _CONCRETE),
        rectangle((60.0, 0.0, 4.5), (160.0, 5.0), _LEVEL, _CONCRETE),
        *(rectangle((60.0, y, 2.25), (160.0, 4.5), _FACES_Y, _CONCRETE) for y in (-2.5, 2.5)),
        *(rectangle((x, 0.0, 2.25), (5.0, 4.5), _FACES_X, _CONCRETE) for x in (-20.0, 140.0)),
    ]
    for x in rng.uniform(-10.0, 130.0, 4):
        primitives.append(_standing(float(x), 2.3, (0.5, 0.3, 0.9), _STEEL))
    waypoints = np.array([(0.0, 0.0, 1.2), (90.0, 0.0, 1.2)])
    return Place(world=SimulatedWorld(primitives), course=Course(waypoints=waypoints, corner=1.0, closed=False))


def long_tunnel(rng: np.random.Generator) -> Place:
    """Return a smooth straight tunnel of 300 m, 6 m by 5 m, closed, with boxes and columns in its first and last 15 m.

    From the middle no return of a sensor that reaches 90 m faces the axis.
    """
    length, width, height = 300.0, 6.0, 5.0
    primitives = [
        *(rectangle((length / 2.0, 0.0, z), (length, width), _LEVEL, _CONCRETE) for z in (0.0, height)),
        *(rectangle((length / 2.0, y, height / 2.0), (length, height), _FACES_Y, _CONCRETE) for y in (-3.0, 3.0)),
        *(rectangle((x, 0.0, height / 2.0), (width, height), _FACES_X, _CONCRETE) for x in (0.0, length)),
    ]
    for begin in (0.0, length - 15.0):
        for x in np.linspace(begin + 1.0, begin + 14.0, 5):
            side = float(rng.choice([-1.0, 1.0]))
            primitives.append(_carton(rng, x + rng.normal(0.0, 0.3), side * 2.4, 0.0, (1.2, 1.0, 1.6)))
            primitives.append(
                cylinder((x + rng.normal(0.0, 0.3), -side * 2.7, height / 2.0), 0.15, height, None, _STEEL)
            )
    waypoints = np.array([(5.0, 0.0, 1.2), (length - 5.0, 0.0, 1.2)])
    return Place(world=SimulatedWorld(primitives), course=Course(waypoints=waypoints, corner=1.0, closed=False))


def street(rng: np.random.Generator) -> Place:
    """Return a street of 280 m between houses, with parked cars, poles and trees, that ends in a wide bend."""
    primitives = [rectangle((140.0, 20.0, 0.0), (460.0, 260.0), _LEVEL, _ASPHALT)]
    for side in (-1.0, 1.0):
        x = -60.0
        while x < 330.0:  # houses of different depth, with gaps between them
            length, depth, height = rng.uniform((9.0, 8.0, 5.0), (18.0, 12.0, 12.0))
            if side < 0.0 or x + length < 215.0:
                y = side * (9.0 + rng.uniform(0.0, 3.0) + depth / 2.0)
                primitives.append(_standing(x + length / 2.0, y, (length, depth, height), _BRICK))
            x += length + rng.uniform(1.5, 6.0)
        for x in np.arange(-50.0, 230.0, 22.0):
            primitives.append(cylinder((x + rng.normal(0.0, 1.5), side * 5.6, 3.5), 0.1, 7.0, None, _STEEL))
        for x in np.arange(-45.0, 225.0, 9.0):
            if rng.random() < 0.55:
                car = rng.uniform((3.8, 1.7, 1.4), (5.2, 1.9, 2.0))
                primitives.append(_standing(x, side * 4.4, car, _PANEL, yaw=rng.normal(0.0, 0.03)))
    for x, y in rng.uniform((225.0, 15.0), (320.0, 130.0), (30, 2)):  # a park inside and outside of the bend
        if abs(np.hypot(x - 225.0, y - 60.0) - 60.0) > 8.0 and abs(x - 285.0) > 8.0:
            primitives.append(cylinder((x, y, 2.0), 0.25, 4.0, None, _WOOD))
            primitives.append(box((x, y, 5.0), rng.uniform(2.0, 3.5, 3), _yaw(rng.uniform(-0.5, 0.5)), _GRASS))
    waypoints = np.array([(0.0, 0.0, 1.7), (285.0, 0.0, 1.7), (285.0, 200.0, 1.7)])
    return Place(world=SimulatedWorld(primitives), course=Course(waypoints=waypoints, corner=60.0, closed=False))


def traffic(rng: np.random.Generator) -> Place:
    """Return the street with cars on both lanes, a lorry ahead and people on the pavements, and a way along it."""
    movers = []
    for k, x in enumerate(np.arange(-40.0, 200.0, 20.0)):  # both lanes, some of them faster than the sensor
        lane, size = (-1.9, 1.9)[k % 2], rng.uniform((3.8, 1.7, 1.4), (5.2, 1.9, 2.0))
        car = SimulatedWorld([_standing(0.0, 0.0, size, _PANEL), _standing(-0.3, 0.0, 0.8 * size, _PANEL, z=0.5)])
        movers.append(_mover(car, (-60.0, lane), (230.0, lane), rng.uniform(4.0, 12.0), x + 60.0 + 290.0 * (k % 2)))
    lorry = SimulatedWorld([_standing(0.0, 0.0, (9.0, 2.5, 3.4), _PANEL)])
    movers.append(_mover(lorry, (-60.0, 0.0), (230.0, 0.0), 5.0, 74.0))
    for side in (-1.0, 1.0):
        for x in rng.uniform(-10.0, 120.0, 6):
            person = SimulatedWorld([cylinder((0.0, 0.0, 0.85), 0.22, 1.7, None, _WOOD)])
            y = side * rng.uniform(6.3, 7.5)
            movers.append(_mover(person, (x - 15.0, y), (x + 15.0, y), rng.uniform(0.8, 1.6), rng.uniform(0.0, 60.0)))
    waypoints = np.array([(0.0, 0.0, 1.7), (200.0, 0.0, 1.7)])
    return Place(
        world=street(rng).world,
        course=Course(waypoints=waypoints, corner=1.0, closed=False),
        movers=tuple(movers),
    )


def _mover(world: SimulatedWorld, a: tuple[float, float], b: tuple[float, float], speed: float, phase: float) -> Mover:
    return Mover(world=world, a=np.array([*a, 0.0]), b=np.array([*b, 0.0]), speed=float(speed), phase=float(phase))


def forest(rng: np.random.Generator) -> Place:
    """Return a wood on uneven ground, with thin branches and bushes, and a loop in it."""
    height = ground_height(rng, (12.0, 40.0), 0.25)
    return Place(world=SimulatedWorld(forest_world(rng, height)), course=ground_course(height, eye=1.2))


def rough(rng: np.random.Generator) -> Place:
    """Return open ground of short waves strewn with stones, and a loop over it."""
    height = ground_height(rng, (3.0, 14.0), 0.12)
    return Place(world=SimulatedWorld(rough_world(rng, height)), course=ground_course(height, eye=0.9))


def campus(rng: np.random.Generator) -> Place:
    """Return two blocks of houses and the streets around them; the street between them is walked twice."""
    return Place(world=SimulatedWorld(campus_world(rng)), course=campus_course())


def city(rng: np.random.Generator) -> Place:
    """Return a loop of 3 km through streets with houses on both sides, that ends where it began."""
    return Place(world=SimulatedWorld(city_world(rng)), course=city_course())


def storeys(rng: np.random.Generator) -> Place:
    """Return a building of two equal storeys with three equal corridors each."""
    return Place(world=SimulatedWorld(storeys_world(rng)), course=storeys_course())


def _relief(rng: np.random.Generator) -> Callable[[ArrayLike, ArrayLike], NDArray[np.float64]]:
    """Return the height of rolling ground over x and y: waves of 20 to 70 m, 0.25 to 0.4 m from trough to crest."""
    waves = 5
    length, heading, phase = (
        rng.uniform(20.0, 70.0, waves),
        rng.uniform(0.0, np.pi, waves),
        rng.uniform(0.0, 7.0, waves),
    )
    k = 2.0 * np.pi / length * np.array([np.cos(heading), np.sin(heading)])
    height = rng.uniform(0.25, 0.4) / (2.0 * np.sqrt(waves))

    def at(x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(height * np.sin(np.multiply.outer(x, k[0]) + np.multiply.outer(y, k[1]) + phase).sum(axis=-1))

    return at


def _open_ground(rng: np.random.Generator, poles: int) -> Place:
    """Return rolling ground of 150 m a side, in facets of 2.5 m, with poles far off; the way is a loop of 98 m."""
    relief, edge, half = _relief(rng), 2.5, 75.0
    primitives = []
    for x in np.arange(-half + edge / 2.0, half, edge):
        for y in np.arange(-half + edge / 2.0, half, edge):
            slopes = [relief(x + dx, y + dy) - relief(x - dx, y - dy) for dx, dy in ((edge / 2, 0.0), (0.0, edge / 2))]
            R = so3.from_two_vectors(np.array([0.0, 0.0, 1.0]), np.array([*(-np.array(slopes) / edge), 1.0]))
            # A little larger than its place, so that no ray slips through a seam.
            primitives.append(rectangle((x, y, float(relief(x, y))), (1.01 * edge, 1.01 * edge), R, _GRASS))
    for angle in rng.uniform(0.0, 2.0 * np.pi, poles):
        x, y = rng.uniform(35.0, 60.0) * np.array([np.cos(angle), np.sin(angle)])
        primitives.append(cylinder((x, y, float(relief(x, y)) + 2.0), 0.12, 5.0, None, _STEEL))
    corners = np.array([(0.0, -7.5), (17.0, -7.5), (17.0, 7.5), (-17.0, 7.5), (-17.0, -7.5)])
    waypoints = np.column_stack([corners, relief(*corners.T) + 1.2])
    return Place(world=SimulatedWorld(primitives), course=Course(waypoints=waypoints, corner=4.0))


def open_field(rng: np.random.Generator) -> Place:
    """Return rolling ground with eight poles 35 to 60 m away: next to nothing tells where one is along the ground."""
    return _open_ground(rng, 8)


def bare_field(rng: np.random.Generator) -> Place:
    """Return rolling ground with nothing on it."""
    return _open_ground(rng, 0)


def level_street(rng: np.random.Generator) -> Place:
    """Return the street with a level way of 60 m straight on, on which a tilt cannot be told from a bias."""
    waypoints = np.array([(0.0, 0.0, 1.2), (60.0, 0.0, 1.2)])
    return Place(world=street(rng).world, course=Course(waypoints=waypoints, corner=1.0, closed=False))


def level_aisles(rng: np.random.Generator) -> Place:
    """Return the warehouse with a level way of 52 m that turns three times."""
    waypoints = np.array([(5.0, 6.0, 0.9), (20.0, 6.0, 0.9), (20.0, 18.0, 0.9), (4.0, 18.0, 0.9), (4.0, 8.0, 0.9)])
    return Place(world=warehouse(rng).world, course=Course(waypoints=waypoints, corner=1.6, closed=False))


PLACES: MappingProxyType[str, Callable[[np.random.Generator], Place]] = MappingProxyType(
    {
        "aisle_laps": aisle_laps,
        "aisles": aisles,
        "campus": campus,
        "city": city,
        "forest": forest,
        "level_room": level_room,
        "long_tunnel": long_tunnel,
        "bare_field": bare_field,
        "level_aisles": level_aisles,
        "level_street": level_street,
        "open_field": open_field,
        "room": room,
        "rough": rough,
        "storeys": storeys,
        "street": street,
        "traffic": traffic,
        "tunnel": tunnel,
        "warehouse": warehouse,
        "warehouse_laps": warehouse_laps,
    }
)
