"""LOAM's step on a simulated room: clouds of all kinds, little to match, and no IMU."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Scan
from heliograph.errors import ConfigError, DataError
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, simulate

SMALL = SCENARIOS["room"].thinned(beams=16, columns=360, duration=4.0)
BOTH, LIDAR = frozenset({"lidar", "imu"}), frozenset({"lidar"})
CONFIG = RunConfig(odometry="loam")


def follow(records, rig, sensors=BOTH, config=CONFIG, threads=1):
    odometry = make_odometry(config, rig, sensors, threads)
    results = [result for record in records for result in odometry.add(record)]
    return odometry, results + odometry.finish()


def errors(simulation, results):
    """Distances [m] from the truth at each scan's end, aligned at the first."""
    truth = simulation.truth.pose(np.array([r.end_ns for r in results]))
    found = np.stack([r.T_odom_imu for r in results])
    moved = truth[0] @ np.linalg.inv(found[0]) @ found
    return np.linalg.norm(moved[:, :3, 3] - truth[:, :3, 3], axis=1)


@pytest.fixture(scope="module")
def walk():
    simulation = simulate(SMALL, 1)
    return simulation, list(simulation)


def changed(records, change):
    return [change(record) if isinstance(record, Scan) else record for record in records]


def test_loam_follows_a_walk_and_knows_how_well(walk):
    simulation, records = walk
    odometry, results = follow(records, simulation.rig)
    assert {r.status for r in results[1:]} == {"tracked"}
    assert errors(simulation, results).max() < 0.02
    sigma = np.sqrt([np.trace(r.pose_covariance[3:, 3:]) for r in results])
    assert (errors(simulation, results)[5:] < 4.0 * sigma[5:] + 0.005).all()
    assert results[-1].matches > 80
    assert np.linalg.eigvalsh(results[-1].lidar_information)[0] > 0.0
    assert next(e.message for e in odometry.events if e.code == "scan-lines").startswith(
        "scan lines are found by ring;"
    )


def test_without_an_imu_loam_is_refused_in_one_line(walk):
    simulation, records = walk
    with pytest.raises(ConfigError, match=r"loam needs an IMU .*; use --odometry filter"):
        make_odometry(CONFIG, simulation.rig, LIDAR, 1)
    scans = [record for record in records if isinstance(record, Scan)]
    with pytest.raises(DataError, match=r"none of its samples are at the first scans; use --odometry filter"):
        follow(scans, simulation.rig)  # an IMU that says nothing


@pytest.mark.parametrize("case", ["no rings", "one ring", "shuffled", "dual return", "no times"])
def test_clouds_of_other_kinds_are_used_and_it_says_how(walk, case):
    simulation, records = walk
    rng = np.random.default_rng(0)

    def change(scan):
        if case == "no rings":
            return replace(scan, ring=None)
        if case == "one ring":
            return replace(scan, ring=np.zeros_like(scan.ring))
        if case == "shuffled":
            return replace(scan.taken(rng.permutation(len(scan)).astype(np.int32)), ring=None)
        if case == "dual return":
            both = scan.taken(np.repeat(np.arange(len(scan), dtype=np.int32), 2))
            near = np.where(np.arange(len(both)) % 4 == 0, 0.8, 1.0).astype(np.float32)
            return replace(both, points=both.points * near[:, None])
        return replace(scan, offsets_ns=np.zeros_like(scan.offsets_ns), has_point_times=False)

    odometry, results = follow(changed(records, change), simulation.rig)
    assert errors(simulation, results).max() < (0.25 if case == "no times" else 0.03)
    said = {e.code: e.message for e in odometry.events}
    assert ("dual-return" in said) == (case == "dual return")
    expected = {"no rings": "by elevation, because no rings", "one ring": "by elevation, because the rings do not tell"}
    assert expected.get(case, "scan lines") in said["scan-lines"]


def test_a_cloud_without_lines_is_refused(walk):
    simulation, records = walk
    rng = np.random.default_rng(0)

    def scatter(scan):
        beam = rng.normal(size=(len(scan), 3))
        points = (5.0 * beam / np.linalg.norm(beam, axis=1, keepdims=True)).astype(np.float32)
        return replace(scan, points=points[:1500], offsets_ns=scan.offsets_ns[:1500], ring=None, intensity=None)

    with pytest.raises(DataError, match="no scan lines"):
        follow(changed(records, scatter), simulation.rig)


def test_scans_that_show_nothing_are_carried_on_by_the_imu(walk):
    simulation, records = walk
    blind = range(25, 29)
    seen = 0

    def cover(scan):
        nonlocal seen
        seen += 1
        return scan.taken(np.arange(200, dtype=np.int32)) if seen - 1 in blind else scan

    _, results = follow(changed(records, cover), simulation.rig)
    assert {results[k].status for k in blind} == {"predicted"}
    assert results[29].status == "tracked"
    assert errors(simulation, results).max() < 0.05
    sigma = [r.pose_covariance[3, 3] for r in results]
    assert sigma[28] > sigma[24]


def test_a_scan_from_elsewhere_is_not_believed(walk):
    simulation, records = walk
    seen = 0

    def elsewhere(scan):
        nonlocal seen
        seen += 1
        return scan if seen != 30 else replace(scan, points=(scan.points @ np.diag([2.3, 0.4, 1.0]).astype(np.float32)))

    _, results = follow(changed(records, elsewhere), simulation.rig)
    assert errors(simulation, results).max() < 0.05


def test_results_do_not_depend_on_threads(walk):
    simulation, records = walk
    few = records[: len(records) // 3]
    one, two = (follow(few, simulation.rig, threads=n)[1] for n in (1, 2))
    assert len(one) > 5
    assert all(a.T_odom_imu.tobytes() == b.T_odom_imu.tobytes() for a, b in zip(one, two, strict=True))


def test_what_loam_does_not_estimate_is_refused_or_said(walk):
    simulation, _ = walk
    estimating = replace(CONFIG, filter=replace(CONFIG.filter, estimate_mounting=True))
    with pytest.raises(ConfigError, match="takes mounting and clock as given"):
        make_odometry(estimating, simulation.rig, BOTH, 1)
    guess = replace(simulation.rig, known=False)
    assert [e.code for e in make_odometry(CONFIG, guess, BOTH, 1).events] == ["mounting-uncertain"]


def test_the_imu_alone_is_dead_reckoned(walk):
    simulation, records = walk
    samples = [record for record in records if isinstance(record, ImuBatch)]
    _, results = follow(samples, simulation.rig, frozenset({"imu"}))
    assert len(results) > 10
    assert results[-1].status == "predicted"
