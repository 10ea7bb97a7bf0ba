"""LOAM's step on a simulated room: clouds of all kinds, little to match, with an IMU and without."""

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


def test_without_an_imu_loam_follows_the_walk_by_its_scans(walk):
    simulation, records = walk
    _, results = follow(records, simulation.rig, LIDAR)
    assert sum(r.status == "tracked" for r in results[1:]) >= len(results) - 2  # one may not settle
    assert errors(simulation, results).max() < 0.05
    sigma = np.sqrt([np.trace(r.pose_covariance[3:, 3:]) for r in results])
    assert (errors(simulation, results)[5:] < 4.0 * sigma[5:] + 0.005).all()


def test_an_imu_that_says_nothing_is_done_without(walk):
    simulation, records = walk
    scans = [record for record in records if isinstance(record, Scan)][:20]
    _, results = follow(scans, simulation.rig)
    assert sum(r.status == "tracked" for r in results) >= 18


@pytest.mark.parametrize("always", [False, True])
def test_scan_to_scan_before_scan_to_map_leads_to_the_same_place(walk, always):
    simulation, records = walk
    config = replace(CONFIG, loam=replace(CONFIG.loam, scan_to_scan=always))
    _, results = follow(records[: len(records) // 2], simulation.rig, LIDAR, config)
    assert sum(r.status == "tracked" for r in results) >= 0.8 * len(results)
    assert errors(simulation, results).max() < 0.05


def test_without_an_imu_a_whirl_is_never_called_tracked_where_it_is_off():
    shaken = SCENARIOS["start-shaking"].thinned(beams=16, columns=240, duration=4.0)
    simulation = simulate(shaken, 1)
    _, results = follow(simulation, simulation.rig, LIDAR)
    off = errors(simulation, results)
    told = np.mean([r.status in ("lost", "predicted") for r in results])
    assert off.max() > 0.2 and told > 0.1  # what a run calls degraded


@pytest.mark.parametrize("sensors", [BOTH, LIDAR], ids=["led", "alone"])
@pytest.mark.parametrize("case", ["no rings", "one ring", "shuffled", "dual return", "nan dense", "no times"])
def test_clouds_of_other_kinds_are_used_and_it_says_how(walk, case, sensors):
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
        if case == "nan dense":  # every pulse has its place in the message, a fifth of them without a return
            gone = rng.random(len(scan)) < 0.2
            return replace(scan, points=np.where(gone[:, None], np.float32(np.nan), scan.points))
        return replace(scan, offsets_ns=np.zeros_like(scan.offsets_ns), has_point_times=False)

    odometry, results = follow(changed(records, change), simulation.rig, sensors)
    assert errors(simulation, results).max() < (0.25 if case == "no times" else 0.03 if sensors == BOTH else 0.06)
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
