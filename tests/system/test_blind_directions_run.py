"""Where a direction is not seen: sigmas that say so in metres, and none of it where a little is seen. Slow tests."""

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.lie import so3
from heliograph.odometry import make_odometry
from heliograph.output.blind_spans import BlindSpans
from heliograph.sim import SCENARIOS, simulate

AXIS = np.array([1.0, 0.0, 0.0])


def run(scenario, seed):
    """Results, the true poses in the odom frame, and errors of position in it."""
    simulation = simulate(scenario, seed)
    odometry = make_odometry(RunConfig(), simulation.rig, frozenset({"lidar", "imu"}), 1)
    results = [r for record in simulation for r in odometry.add(record)] + odometry.finish()
    truth = simulation.truth.pose(np.array([r.end_ns for r in results]))
    expected = results[0].T_odom_imu @ np.linalg.inv(truth[0]) @ truth
    return results, truth, expected, np.stack([r.T_odom_imu for r in results])[:, :3, 3] - expected[:, :3, 3]


def spans_of(results):
    spans = BlindSpans()
    for result in results:
        spans.add(result)
    return spans.all(np.eye(3))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_smooth_tunnel_costs_what_its_sigma_says(seed):
    results, truth, expected, error = run(SCENARIOS["long-tunnel"], seed)
    axis = expected[0, :3, :3] @ truth[0, :3, :3].T @ AXIS
    side = np.cross([0.0, 0.0, 1.0], axis)
    long = max(spans_of(results), key=lambda span: span.distance)
    assert abs(long.direction @ axis) > 0.999
    assert 60.0 < truth[long.first, 0, 3] < 110.0  # nothing but walls within sight from here ...
    assert 180.0 < truth[long.last, 0, 3] < 250.0  # ... to there
    assert long.sigma_before < 0.02
    assert 0.3 < long.sigma_after < 1.5  # 0.026 m when the noise of normals was taken for information
    assert abs(error[long.last] @ axis) < 3.0 * long.sigma_after
    # The exit is used: the error does not grow on, and the velocity is right again.
    assert abs((error[-1] - error[long.last]) @ axis) < 0.15
    assert np.abs(error @ side).max() < 0.10
    turn = so3.log(np.swapaxes(expected[:, :3, :3], 1, 2) @ np.stack([r.T_odom_imu[:3, :3] for r in results]))
    assert np.degrees(np.linalg.norm(turn, axis=1)).max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["field", "bare-field"])
def test_open_field_is_seen_however_weakly(name):
    results, _, _, error = run(SCENARIOS[name], 1)
    statuses = [r.status for r in results[1:]]
    assert statuses.count("degenerate") < 0.25 * len(statuses)
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.06
    sigma = np.sqrt(np.diag(results[-1].pose_covariance)[3:])
    assert (np.abs(error[-1]) < 3.0 * sigma).all()
    assert all(span.growth < 0.1 for span in spans_of(results))
