"""Distances of points from a simulated world's surfaces, and the world read back from a recording's folder."""

import numpy as np
import pytest

from heliograph.errors import ConfigError, DataError, FormatError
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, Simulation
from heliograph.sim.map_error import map_error
from heliograph.sim.scenario import to_toml
from heliograph.sim.world import SimulatedWorld, box, cylinder, rectangle
from heliograph.sim.write import read_simulation

SMALL = SCENARIOS["room"].thinned(beams=16, columns=64, duration=1.0)


@pytest.mark.parametrize(
    ("thing", "point", "distance"),
    [
        (box((1.0, 0.0, 0.0), (2.0, 2.0, 2.0)), (2.5, 0.0, 0.0), 0.5),
        (box((1.0, 0.0, 0.0), (2.0, 2.0, 2.0)), (1.7, 0.1, 0.0), 0.3),  # inside
        (box((1.0, 0.0, 0.0), (2.0, 2.0, 2.0)), (2.3, 1.4, 0.0), 0.5),  # off an edge
        (box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), so3.exp([0.0, 0.0, np.pi / 4])), (2.0, 0.0, 0.0), 2.0 - np.sqrt(2.0)),
        (cylinder((0.0, 0.0, 0.0), 1.0, 4.0), (0.0, 3.0, 0.0), 2.0),
        (cylinder((0.0, 0.0, 0.0), 1.0, 4.0), (0.0, 0.6, 0.0), 0.4),  # inside, by the mantle
        (cylinder((0.0, 0.0, 0.0), 1.0, 4.0), (0.0, 0.0, 1.9), 0.1),  # inside, by a cap
        (rectangle((0.0, 0.0, 0.0), (2.0, 2.0), np.eye(3)), (0.5, 0.5, -0.2), 0.2),
        (rectangle((0.0, 0.0, 0.0), (2.0, 2.0), np.eye(3)), (4.0, 1.0, 4.0), 5.0),
    ],
)
def test_distance_from_one_thing(thing, point, distance):
    far = box((50.0, 50.0, 50.0), (1.0, 1.0, 1.0))
    found = SimulatedWorld([far, thing]).distance(np.array([point]))
    np.testing.assert_allclose(found, [distance], atol=1e-12)


def test_map_error_tells_noise_from_what_lies_elsewhere(rng):
    floor = SimulatedWorld([rectangle((0.0, 0.0, 0.0), (20.0, 20.0), np.eye(3))])
    points = np.column_stack([rng.uniform(-9.0, 9.0, (200_000, 2)), 0.004 * rng.standard_normal(200_000)])
    points[::20, 2] = 0.4
    error = map_error(floor, points)
    assert error.points == 100_000
    assert error.median == pytest.approx(0.0029, rel=0.1)
    assert error.far_share == pytest.approx(0.1, abs=1e-6)  # every second point is looked at
    with pytest.raises(DataError, match="no point"):
        map_error(floor, points[:0])


def test_world_is_read_back_as_it_was_simulated(tmp_path):
    assert read_simulation(tmp_path) is None
    (tmp_path / "scenario.toml").write_text("# seed 7, layout ouster\n" + to_toml(SMALL))
    found, made = read_simulation(tmp_path), Simulation(SMALL, 7)
    np.testing.assert_array_equal(found.world.packed, made.world.packed)
    assert found.seed == 7 and found.scenario == SMALL


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (to_toml(SMALL).encode(), FormatError),  # of which seed?
        (b"# seed 1, layout ouster\nname = 3\n", ConfigError),
        (b"# seed 1\nnothing", ConfigError),
        (b"# seed 1\n\xff", FormatError),
    ],
)
def test_spoilt_scenario_is_told(tmp_path, text, error):
    (tmp_path / "scenario.toml").write_bytes(text)
    with pytest.raises(error):
        read_simulation(tmp_path)
