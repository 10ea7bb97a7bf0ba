"""The law of parts that a run is taken up with: each goes on from its state as if nothing had been."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from fakes import make_batch, make_result, make_scan
from heliograph.checkpoint import RECORDS
from heliograph.checks import RunWatch
from heliograph.config import CheckConfig, GnssConfig, RunConfig
from heliograph.config_toml import apply_overrides
from heliograph.data import GnssFix, ImuBatch, Scan, Trajectory
from heliograph.lie import se3
from heliograph.maps import FeatureMap, FeaturePoints, VoxelMap
from heliograph.odometry import PoseFileOdometry, make_odometry
from heliograph.odometry.sequencer import ImuBuffer, Sequencer
from heliograph.output.blind_spans import BlindSpans
from heliograph.output.scan_log import ScanLog
from heliograph.output.summary import Tally
from heliograph.sim import SCENARIOS, simulate
from heliograph.slam.gnss.intake import FixIntake
from heliograph.slam.keyframes import KeyframeSelector
from heliograph.snapshots import Stateful
from heliograph.testing import assert_goes_on


def goes_on(make, step, inputs, at):
    assert_goes_on(make, step, inputs, at=at, records=RECORDS)


@pytest.fixture(scope="module")
def simulation():
    return simulate(SCENARIOS["room"].thinned(beams=16, columns=256, duration=2.5), seed=1)


@pytest.fixture(scope="module")
def results(simulation):
    odometry = make_odometry(RunConfig(), simulation.rig, frozenset({"lidar", "imu"}), 1)
    return list(itertools.chain.from_iterable(odometry.add(message) for message in simulation))


@pytest.mark.parametrize(
    "settings", [(), ("filter.estimate_mounting=true", "filter.estimate_time_offset=true"), ("odometry='loam'",)]
)
def test_odometry_goes_on(simulation, settings):
    config, names = apply_overrides(RunConfig(), settings), frozenset({"lidar", "imu"})
    messages = [message for message in simulation if isinstance(message, (Scan, ImuBatch))]
    goes_on(
        lambda: make_odometry(config, simulation.rig, names, 1),
        lambda odometry, message: tuple(untimed(result) for result in odometry.add(message)),
        messages,
        int(0.8 * len(messages)),
    )


def untimed(result):
    return replace(result, timings={})


@pytest.mark.parametrize("name", ["filter", "loam"])
def test_odometry_without_an_imu_goes_on(simulation, name):
    messages = [message for message in simulation if isinstance(message, Scan)][:20]
    config = RunConfig(odometry=name)
    make = lambda: make_odometry(config, simulation.rig, frozenset({"lidar"}), 1)  # noqa: E731
    step = lambda odometry, scan: tuple(untimed(result) for result in odometry.add(scan))  # noqa: E731
    goes_on(make, step, messages, 15)


def test_poses_of_a_file_go_on():
    stamps = make_scan(0).stamp_ns + np.arange(30, dtype=np.int64) * 100_000_000
    poses = se3.exp(np.linspace(0.0, 1.0, 30)[:, None] * np.array([0.1, 0.2, 0.3, 1.0, 2.0, 0.0]))
    trajectory = Trajectory(stamps_ns=stamps, T_frame_body=poses)
    goes_on(
        lambda: PoseFileOdometry(trajectory, RunConfig(), np.eye(4)),
        lambda odometry, index: tuple(odometry.add(make_scan(index))),
        list(range(40)),
        at=12,
    )


@pytest.mark.parametrize("at", [1, 7, 12])
def test_sequencer_goes_on(at):
    messages = [message for k in range(12) for message in (make_scan(k), make_batch(k))]
    goes_on(
        lambda: Sequencer(frozenset({"lidar", "imu"})), lambda part, message: tuple(part.add(message)), messages, at
    )


def test_imu_buffer_goes_on():
    def step(buffer, index):
        buffer.append(make_batch(index))
        return buffer.between(make_scan(index - 1).stamp_ns, make_scan(index).stamp_ns)

    goes_on(ImuBuffer, step, list(range(8)), 5)


def test_local_map_goes_on(rng):
    scans = [rng.uniform(-6.0, 6.0, (400, 3)).astype(np.float32) * np.float32([1, 1, 0.01]) for _ in range(30)]
    queries = rng.uniform(-6.0, 6.0, (50, 3))

    def step(grown, points):
        share = grown.insert(points, se3.exp(np.array([0.0, 0.0, 0.02, 0.3, 0.0, 0.0]) * float(points[0, 0])))
        grown.prune(np.array([float(points[0, 1]), 0.0, 0.0]))
        grown.forget_unseen(6)
        return share, grown.planes_at(queries, gate=0.3), grown.table()

    goes_on(VoxelMap, step, scans, 17)


def test_feature_map_goes_on(rng):
    scans = [
        FeaturePoints(edges=part[:50], planes=part[50:])
        for part in (rng.uniform(-6.0, 6.0, (400, 3)).astype(np.float32) for _ in range(12))
    ]

    def step(grown, points):
        share = grown.insert(points, np.eye(4))
        grown.prune(np.zeros(3))
        return share, grown.edges.cells(), grown.planes.cells()

    goes_on(lambda: FeatureMap(radius=5.0), step, scans, 7)


def test_counts_and_checks_go_on(results):
    def count(tally, result):
        tally.add(result)
        return tally.summary()

    goes_on(Tally, count, results, 11)
    goes_on(BlindSpans, lambda part, k: part.add(make_result(k, status="degenerate" if k % 4 else "tracked")),
            list(range(40)), 21)  # fmt: skip

    def watch():
        return RunWatch(frozenset({"lidar", "imu"}), CheckConfig())

    def look(part, k):
        part.observe(make_batch(k))
        return part.add(make_result(k))

    goes_on(watch, look, list(range(160)), 131)


def test_table_of_scans_goes_on(tmp_path, results):
    number = itertools.count()

    def step(log, result):
        log.add(untimed(result))
        return log.snapshot()["size"]

    goes_on(lambda: ScanLog(tmp_path / f"{next(number)}.csv"), lambda log, r: log.add(untimed(r)), [], 0)
    log = ScanLog(tmp_path / "one.csv")
    for result in results[:9]:
        step(log, result)
    state = log.snapshot()
    for result in results[9:]:
        step(log, result)
    log.release()
    whole = log.path.read_bytes()
    again = ScanLog(tmp_path / "one.csv")
    again.restore(state)
    for result in results[9:]:
        step(again, result)
    again.release()
    assert again.path.read_bytes() == whole


def test_fixes_go_on():
    fixes = [
        GnssFix(stamp_ns=k * 10**9, received_ns=k * 10**9, latitude_deg=48.0 + 1e-5 * k, longitude_deg=11.0,
                altitude=500.0, covariance_enu=np.eye(3) * (1.0 + k) if k % 3 else None)
        for k in range(12)
    ]  # fmt: skip

    def step(intake, fix):
        intake.add(fix)
        return intake.positions()

    goes_on(lambda: FixIntake(GnssConfig()), step, fixes, 5)


def test_selection_of_keyframes_goes_on(results):
    config = apply_overrides(RunConfig(), ["slam.keyframe_distance=0.1"]).slam

    def step(selector, k):
        selector.observe(make_batch(k))
        return selector.add(results[k])

    goes_on(lambda: KeyframeSelector(config), step, list(range(len(results))), 12)


class Forgetful(Stateful):
    """Counts, and leaves one of its two counts out of its state."""

    _STATE = {"count": int}  # noqa: RUF012

    def __init__(self):
        self.count = self.others = 0

    def add(self, item):
        self.count, self.others = self.count + 1, self.others + item
        return self.count, self.others


class Credulous(Stateful):
    """Takes anything for its state."""

    def __init__(self):
        self.count = 0

    def add(self, item):
        self.count += item

    def snapshot(self):
        return {"count": self.count}

    def restore(self, snapshot):
        self.count = snapshot.get("count", 0)


def test_law_of_parts_sees_what_is_forgotten_and_what_is_taken_for_granted():
    with pytest.raises(AssertionError, match="input 3: another result"):
        assert_goes_on(Forgetful, Forgetful.add, [1, 2, 3, 4], at=3)
    with pytest.raises(AssertionError, match="a state that is none was taken up"):
        assert_goes_on(Credulous, Credulous.add, [1, 2], at=1)
