"""Level ways of 50 m: what is known of up, and what that is worth in metres of height."""

import numpy as np
import pytest
from test_odometry import BOTH, LIDAR, poses, run, truth_of

from heliograph.config import RunConfig
from heliograph.config_toml import apply_overrides
from heliograph.lie import so3
from heliograph.output.level import Level
from heliograph.output.summary import Tally
from heliograph.sim import SCENARIOS, simulate


def heights(scenario, seed):
    """Error of the height at each scan, levelled by the last gravity, and the sigma that the run gives it [m]."""
    simulation = simulate(scenario, seed)
    results, odometry = run(simulation, simulation.rig)
    tally = Tally()
    for result in results:
        tally.add(result)
    level: Level = tally.summary().level
    T, truth = odometry.leveling() @ poses(results), truth_of(simulation, results)
    error = T[:, 2, 3] - T[0, 2, 3] - (truth[:, 2, 3] - truth[0, 2, 3])
    covariance = np.stack([result.pose_covariance[3:, 3:] for result in results])
    covariance = covariance + level.of_positions(poses(results)[:, :3, 3])
    return error, np.sqrt(covariance[:, 2, 2]), level


def test_a_straight_way_leaves_a_tilt_that_its_sigma_covers():
    scenario = SCENARIOS["level-straight"].thinned(beams=12, columns=256, duration=14.0)
    error, sigma, level = heights(scenario, 2)
    assert 0.2 < np.degrees(level.sigma) < 0.6
    assert level.sigma_position == pytest.approx(sigma[-1], rel=0.25)
    assert abs(error[-1]) > 0.03  # the map leans: without the tilt's part the sigma would be 1 cm
    assert (np.abs(error[1:]) < 2.5 * sigma[1:]).all()


@pytest.mark.slow
def test_straight_level_walks_know_their_height_to_twice_what_they_err():
    errors, sigmas = [], []
    for seed in range(1, 21):
        error, sigma, level = heights(SCENARIOS["level-straight"].thinned(beams=16), seed)
        errors.append(error[-1])
        sigmas.append(sigma[-1])
        assert "m of height" in level.sentence()
    errors, sigmas = np.array(errors), np.array(sigmas)
    assert np.mean(np.abs(errors) < 2.0 * sigmas) >= 0.9
    assert np.median(sigmas) <= 2.0 * np.sqrt(np.mean(errors**2))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 21))
def test_turns_tell_the_tilt_and_level_the_way_before_them_too(seed):
    error, _, _ = heights(SCENARIOS["level-turns"].thinned(beams=16), seed)
    assert np.abs(error).max() <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", ["field", "bare-field"])
@pytest.mark.parametrize("seed", range(1, 11))
def test_open_ground_is_begun_at_rest_and_tracked(name, seed):
    simulation = simulate(SCENARIOS[name].thinned(duration=30.0), seed)
    results, odometry = run(simulation, simulation.rig)
    assert odometry.start.kind == "static"
    T, truth = poses(results), truth_of(simulation, results)
    expected = T[0] @ np.linalg.inv(truth[0]) @ truth
    assert np.linalg.norm(expected[:, :3, 3] - T[:, :3, 3], axis=1).max() < 0.5


@pytest.mark.parametrize("sensors", [BOTH, LIDAR])
def test_without_deskewing_a_body_at_rest_stays_where_it_is(sensors):
    scenario = SCENARIOS["room"].thinned(beams=16, columns=128).varied(walk={"rest": 20.0, "duration": 4.0})
    simulation = simulate(scenario, 1)
    config = apply_overrides(RunConfig(), ["cloud.deskew=off"])
    results, _ = run(simulation, simulation.rig, sensors=sensors, config=config)
    assert np.linalg.norm(poses(results)[:, :3, 3], axis=1).max() < 0.03


def lidar_nees(scenario, seed):
    """NEES of the pose against the odom origin at each scan of a run without the IMU."""
    simulation = simulate(scenario, seed)
    results, _ = run(simulation, simulation.rig, sensors=LIDAR)
    T, truth = poses(results), truth_of(simulation, results)
    expected = T[0] @ np.linalg.inv(truth[0]) @ truth
    turn = so3.log(np.swapaxes(T[:, :3, :3], -1, -2) @ expected[:, :3, :3])
    errors = np.concatenate([turn, (expected - T)[:, :3, 3]], axis=1)
    return np.array([e @ np.linalg.solve(r.pose_covariance, e) for e, r in zip(errors[1:], results[1:], strict=True)])


def test_lidar_alone_knows_what_a_waving_hand_does_to_its_sweeps():
    nees = lidar_nees(SCENARIOS["calibration"].thinned(beams=16, duration=8.0), 1)
    assert 0.1 < np.median(nees) < 6.0
    assert np.mean(nees) < 6.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize(
    ("name", "duration"), [("demo", 20.0), ("room", 20.0), ("calibration", 15.0), ("start-shaking", 8.0)]
)
def test_lidar_alone_is_not_surer_than_it_is_good(name, duration, seed):
    """Drift is no chi-square variable: the mean over a run stays below the dimension, the end below its 99.9 %."""
    nees = lidar_nees(SCENARIOS[name].thinned(beams=16, columns=512, duration=20.0), seed)
    assert np.mean(nees) < 6.0
    assert nees[-1] < 22.5
