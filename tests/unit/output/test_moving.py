"""What moved goes out of the map; poles, edges, ground and walls stay."""

import numpy as np
import pytest

from heliograph.config import OutputConfig
from heliograph.maps import GlobalMap, Sight
from heliograph.output.moving import seen_through
from heliograph.sim.sensors import LidarModel, measure_ranges
from heliograph.sim.world import SimulatedWorld, box, cylinder, rectangle

CONFIG = OutputConfig()
LIDAR = LidarModel(beams=48, columns=384, elevation_deg=(-25.0, 15.0), max_range=40.0, range_noise=0.005)
PEOPLE_AT = [(0.5 * k, 3.0) for k in range(14)]  # somebody walks ahead along the wall, one place a scan
STANDS = [
    rectangle((0.0, 0.0, 0.0), (80.0, 80.0), np.eye(3)),
    box((0.0, 7.0, 2.0), (60.0, 0.4, 4.0)),  # seen at a shallow angle farther on
    cylinder((2.0, -2.0, 1.5), 0.04, 3.0),  # a pole
    box((5.0, -3.0, 0.5), (1.5, 0.8, 1.0)),  # a table's worth of edges
]


def scans(people, *, steps=14, way=0.5, noise=0.0, seed=0):
    """One map a scan, and what each scan saw."""
    rng = np.random.default_rng(seed)
    directions = LIDAR.directions()
    for k in range(steps):
        T = np.eye(4)
        T[:3, 3] = -3.0 + way * k, 0.0, 1.4
        person = [cylinder((*people[k], 0.9), 0.25, 1.8)] if people else []
        exact = SimulatedWorld([*STANDS, *person]).cast(
            directions, np.tile(T, (LIDAR.columns, 1, 1)), min_range=0.3, max_range=40.0
        )
        ranges = measure_ranges(exact, LIDAR, rng)
        seen = (directions * ranges[..., None])[ranges > 0.0].astype(np.float32)
        T[:3, 3] += rng.normal(0.0, noise, 3)
        yield k, T, np.ascontiguousarray(seen)


def put_together(people, **changes):
    whole, sights = GlobalMap(0.1), []
    for k, T, seen in scans(people, **changes):
        part = GlobalMap(0.1)
        part.insert(seen, None, T)
        whole.merge(part.cells(), visit=k)
        sights.append(Sight(origin=T[:3, 3], start=T[:3, 3], ends=seen))
    return whole, sights


def is_person(means):
    near = np.linalg.norm(means[:, None, :2] - np.array(PEOPLE_AT), axis=2).min(axis=1)
    return (near < 0.4) & (means[:, 2] > 0.15)


def test_a_walker_goes_and_what_stands_stays():
    whole, sights = put_together(PEOPLE_AT)
    gone, person = seen_through(whole, sights, CONFIG), is_person(whole.means())
    assert person.sum() > 300
    assert np.mean(gone[person]) > 0.7
    assert np.mean(gone[~person]) < 1e-3


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_without_people_next_to_nothing_goes(noise):
    """Poses two centimetres off: the ground at grazing angles, the shallow wall, the pole and the table are there."""
    whole, sights = put_together(None, noise=noise)
    gone, means = seen_through(whole, sights, CONFIG), whole.means()
    assert np.mean(gone) < 1e-3
    pole = np.linalg.norm(means[:, :2] - (2.0, -2.0), axis=1) < 0.15
    assert pole.sum() > 20 and not gone[pole & (means[:, 2] > 0.2)].any()


def test_what_stood_for_long_stays():
    """Somebody who waited while most of the scans were taken is part of the place."""
    waiting = [(2.0, 3.0)] * 10 + [(9.0, 3.0)] * 4
    whole, sights = put_together(waiting)
    there = np.linalg.norm(whole.means()[:, :2] - (2.0, 3.0), axis=1) < 0.4
    assert not seen_through(whole, sights, CONFIG)[there & (whole.visits() > 6)].any()


def test_no_scans_no_verdict():
    whole, _ = put_together(PEOPLE_AT, steps=2)
    assert not seen_through(whole, [], CONFIG).any()
