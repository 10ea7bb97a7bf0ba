"""What moves in a simulated world: where it is, what it hides, and places without walls."""

import numpy as np
import pytest

from heliograph.lie import se3
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.movers import Mover, cast_with_movers
from heliograph.sim.world import SimulatedWorld, box, rectangle

WALL = SimulatedWorld(
    [rectangle((10.0, 0.0, 0.0), (40.0, 40.0), se3.exp(np.array([0, np.pi / 2, 0, 0, 0, 0]))[:3, :3])]
)
CAR = Mover(
    world=SimulatedWorld([box((0.0, 0.0, 0.0), (4.0, 2.0, 2.0))]),
    a=np.array([5.0, -10.0, 0.0]),
    b=np.array([5.0, 10.0, 0.0]),
    speed=4.0,
)


def test_a_mover_goes_to_and_fro_facing_where_it_goes():
    T = CAR.pose([0.0, 2.5, 5.0, 7.5, 10.0])
    np.testing.assert_allclose(T[:, 1, 3], [-10.0, 0.0, 10.0, 0.0, -10.0], atol=1e-9)
    np.testing.assert_allclose(T[[1, 3], :3, 0], [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], atol=1e-9)


def test_a_mover_hides_the_wall_at_the_instant_of_each_column():
    ahead = np.tile([1.0, 0.0, 0.0], (1, 3, 1))
    poses, seconds = np.tile(np.eye(4), (3, 1, 1)), np.array([1.0, 2.5, 4.0])
    found = cast_with_movers(WALL, [CAR], ahead, poses, seconds, min_range=0.1, max_range=50.0)
    np.testing.assert_allclose(found.range[0], [10.0, 4.0, 10.0], atol=1e-5)
    assert found.primitive[0].tolist() == [0, 1, 0]


@pytest.mark.parametrize("name", ["traffic", "forest", "rough"])
def test_places_without_walls_are_seen_all_around(name):
    scenario = SCENARIOS[name].thinned(beams=16, columns=128, duration=0.5)
    first, second = (list(simulate(scenario, seed).sweeps()) for seed in (1, 2))
    assert len(first) == 4
    assert all(0.3 < (sweep.ranges > 0.0).mean() < 1.0 for sweep in (*first, *second))
    assert not np.array_equal(first[0].ranges, second[0].ranges)
