"""The filter's step on a room that a user's own map holds, and what it does with little or nothing to match."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.odometry import FilterOdometry, make_odometry
from heliograph.sim import SCENARIOS, simulate
from neighbour_map import NeighbourMap

SMALL = SCENARIOS["room"].thinned(beams=16, columns=180, duration=6.0)
BOTH = frozenset({"lidar", "imu"})


def follow(records, odometry):
    results = [result for record in records for result in odometry.add(record)]
    return results + odometry.finish()


def errors(simulation, results):
    """Distances [m] from the truth at each scan's end, aligned at the first."""
    stamps = np.array([r.end_ns for r in results])
    truth, found = simulation.truth.pose(stamps), np.stack([r.T_odom_imu for r in results])
    moved = truth[0] @ np.linalg.inv(found[0]) @ found
    return np.linalg.norm(moved[:, :3, 3] - truth[:, :3, 3], axis=1)


@pytest.fixture(scope="module")
def walk():
    simulation = simulate(SMALL, 1)
    return simulation, list(simulation)


def test_filter_runs_on_a_map_of_ones_own(walk):
    simulation, records = walk
    own = NeighbourMap(spacing=0.12)
    config = RunConfig(cloud=replace(RunConfig().cloud, target_points=800))
    odometry = FilterOdometry(config, simulation.rig, sensors=BOTH, local_map=own)
    results = follow(records, odometry)
    assert odometry.core.map is own
    assert len(own) > 1000
    assert {r.status for r in results[1:]} == {"tracked"}
    assert errors(simulation, results).max() < 0.04
    assert np.linalg.norm(results[-1].T_odom_imu[:3, 3]) > 1.0


def test_every_scan_has_one_result_with_its_stamps_and_its_cloud(walk):
    simulation, records = walk
    scans = [r for r in records if isinstance(r, Scan)]
    results = follow(records, make_odometry(RunConfig(), simulation.rig, BOTH, 1))
    assert [r.index for r in results] == list(range(len(scans)))
    assert [r.end_ns for r in results] == [s.end_ns for s in scans]
    assert [r.header_stamp_ns for r in results] == [s.header_stamp_ns for s in scans]
    for result, scan in zip(results, scans, strict=True):
        distance = np.linalg.norm(scan.points, axis=1)
        assert len(result.points_imu) == np.count_nonzero((distance >= 0.5) & (distance <= 150.0))
        assert result.path.stamps_ns[-1] == result.end_ns
        np.testing.assert_allclose(result.path.T_frame_body[-1], result.T_odom_imu, atol=1e-12)
        eigenvalues = np.linalg.eigvalsh(result.covariance)
        assert eigenvalues[0] > -1e-12 * eigenvalues[-1]


def test_paths_of_neighbouring_scans_join(walk):
    simulation, records = walk
    results = follow(records, make_odometry(RunConfig(), simulation.rig, BOTH, 1))
    for before, after in pairwise(results[2:]):
        assert after.path.stamps_ns[0] == before.end_ns
        np.testing.assert_allclose(after.path.T_frame_body[0], before.T_odom_imu, atol=1e-9)


def test_first_scan_defines_the_frame(walk):
    simulation, records = walk
    first = follow(records[:80], make_odometry(RunConfig(), simulation.rig, BOTH, 1))[0]
    assert first.status == "first"
    np.testing.assert_allclose(first.T_odom_imu[:3, 3], 0.0, atol=1e-12)
    assert first.T_odom_imu[1, 0] == pytest.approx(0.0, abs=1e-12)  # x along the heading
    assert first.T_odom_imu[0, 0] > 0.0
    assert np.abs(first.covariance[:6]).max() == 0.0


def test_noise_follows_the_residuals(walk):
    simulation, records = walk
    quiet = FilterOdometry(RunConfig(), simulation.rig, sensors=BOTH)
    results = follow(records, quiet)
    assert quiet.core.noise.sigma < 0.03
    assert results[-1].rms == pytest.approx(quiet.core.noise.sigma, rel=0.5)


def in_tunnel(residual):
    scenario = (
        SCENARIOS["tunnel"]
        .thinned(beams=16, columns=180)
        .varied(walk={"begin": 16.0, "duration": 2.5}, lidar={"max_range": 15.0})
    )
    simulation = simulate(scenario, 1)
    config = RunConfig(filter=replace(RunConfig().filter, residual=residual))
    return simulation, follow(simulation, make_odometry(config, simulation.rig, BOTH, 1))


@pytest.mark.slow
def test_point_to_point_does_not_notice_a_tunnel():
    """The textbook's comparison: it runs, and its information is the same in every direction."""
    _, results = in_tunnel("point")
    assert {r.status for r in results[1:]} == {"tracked"}
    np.testing.assert_allclose([r.eigenvalues_translation for r in results[1:]], 1.0 / 3.0, atol=1e-9)


def test_tunnel_reports_its_blind_direction():
    simulation, results = in_tunnel("plane")
    late = results[5:]
    assert {r.status for r in late} <= {"degenerate", "tracked"}
    assert sum(r.status == "degenerate" for r in late) > 0.7 * len(late)
    blind = [r for r in late if r.status == "degenerate"]
    for result in blind:
        along = result.T_odom_imu[:3, :3] @ simulation.truth.pose(np.array([result.end_ns]))[0][:3, :3].T @ [1, 0, 0]
        assert abs(result.weak_direction @ along) > 0.9
