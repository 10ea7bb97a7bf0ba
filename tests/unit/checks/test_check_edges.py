"""Whatever the records hold, the checks answer: one finding each, of JSON's own types, without a warning."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.checks import IMU_CHECKS, CheckedMotion, CheckReport, ImuRecord, check_imu
from heliograph.checks.windows import orientation_at
from heliograph.data import ImuBatch, Rig, Trajectory
from heliograph.errors import DataError
from heliograph.lie import so3
from heliograph.output.facts import plain
from heliograph.sim import SCENARIOS
from imu_records import made_records, picked

SECOND = 1_000_000_000
VALUES = st.one_of(
    st.floats(-50.0, 50.0), st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e300, -1e5, 9.80665, 1e-300])
)


def answered(imu, motion=None):
    """Check, and require what holds for every answer."""
    findings = check_imu(imu, motion)
    assert len(findings) == len(IMU_CHECKS) == len({finding.code for finding in findings})
    json.dumps(plain(CheckReport(recording="r", findings=findings).as_dict()), allow_nan=False)
    return {finding.code: finding.verdict for finding in findings}


def imu_of(stamps, six, received=None):
    stamps = np.asarray(stamps, dtype=np.int64)
    six = np.asarray(six, dtype=np.float64).reshape(-1, 6)
    received = stamps if received is None else np.asarray(received, dtype=np.int64)
    return ImuRecord(
        stamps_ns=stamps,
        received_ns=received,
        gyro=np.ascontiguousarray(six[:, :3]),
        accel=np.ascontiguousarray(six[:, 3:]),
    )


@settings(max_examples=25, deadline=None)
@given(data=st.data(), n=st.integers(0, 30))
def test_checks_answer_whatever_the_samples_hold(data, n):
    times = st.lists(st.integers(-SECOND, 40 * SECOND), min_size=n, max_size=n)
    stamps, received = data.draw(times), data.draw(times)
    six = data.draw(st.lists(VALUES, min_size=6 * n, max_size=6 * n))
    answered(imu_of(stamps, six, received))


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10_000), begin=st.integers(0, 900), count=st.integers(0, 100), scans=st.integers(0, 99))
def test_checks_answer_however_little_overlaps(seed, begin, count, scans):
    imu, motion = RECORDS
    rng = np.random.default_rng(seed)
    index = np.sort(rng.permutation(np.arange(begin, min(begin + count, len(imu)))))
    part = CheckedMotion(
        trajectory=Trajectory(
            stamps_ns=motion.trajectory.stamps_ns[:scans], T_frame_body=motion.trajectory.T_frame_body[:scans]
        ),
        tracked=rng.random(scans) < 0.7,
        rig=motion.rig,
        sweep=0.1,
    )
    answered(picked(imu, index), part)


RECORDS = made_records(SCENARIOS["room"].varied(imu={"rate": 100.0}).thinned(duration=11.0), seed=5)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 9, 10])
def test_few_samples_are_unknown_not_wrong(n):
    verdicts = answered(picked(RECORDS[0], np.arange(n)), RECORDS[1])
    assert set(verdicts.values()) <= {"ok", "unknown"}


def test_no_motion_is_unknown_where_motion_is_needed():
    n, scans = 2000, 100
    rng = np.random.default_rng(1)
    six = np.concatenate([1e-3 * rng.standard_normal((n, 3)), [0, 0, 9.8] + 0.01 * rng.standard_normal((n, 3))], axis=1)
    T = np.tile(np.eye(4), (scans, 1, 1))
    T[:, :3, 3] += 0.003 * rng.standard_normal((scans, 3))
    motion = CheckedMotion(
        trajectory=Trajectory(stamps_ns=np.arange(scans) * (SECOND // 10), T_frame_body=T),
        tracked=np.ones(scans, bool),
        rig=Rig(T_imu_lidar=np.eye(4), source="tf_static"),
    )
    verdicts = answered(imu_of(np.arange(n) * 5_000_000, six), motion)
    for code in ("gyro-unit", "gyro-axes", "accel-axes", "mounting", "clock-offset", "imu-prediction"):
        assert verdicts[code] == "unknown"
    assert set(verdicts.values()) == {"ok", "unknown"}


def test_all_zero_samples_are_told():
    verdicts = answered(imu_of(np.arange(1000) * 5_000_000, np.zeros((1000, 6))))
    assert verdicts["imu-channels"] == verdicts["accel-unit"] == "fail"


def test_lidar_that_was_never_tracked_is_unknown():
    imu, motion = RECORDS
    lost = CheckedMotion(trajectory=motion.trajectory, tracked=np.zeros(len(motion), bool), rig=motion.rig, sweep=0.1)
    verdicts = answered(imu, lost)
    assert verdicts["gyro-axes"] == verdicts["imu-prediction"] == "unknown"


def test_records_refuse_lengths_that_differ():
    imu, motion = RECORDS
    with pytest.raises(DataError, match="gyro"):
        ImuRecord(stamps_ns=imu.stamps_ns, received_ns=imu.received_ns, gyro=imu.gyro[:5].copy(), accel=imu.accel)
    with pytest.raises(DataError, match="tracked"):
        CheckedMotion(trajectory=motion.trajectory, tracked=np.ones(3, bool), rig=motion.rig)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 50, 101])
def test_orientation_by_blocks_is_the_product_one_by_one(count):
    rng = np.random.default_rng(count)
    stamps = np.arange(count + 1) * 5_000_000
    batch = ImuBatch(
        stamps_ns=stamps, gyro=rng.normal(0.0, 3.0, (count + 1, 3)), accel=np.zeros((count + 1, 3)), received_ns=0
    )
    R = np.eye(3)
    for k, found in enumerate(orientation_at(batch, stamps[:-1])):
        np.testing.assert_allclose(found, R, atol=1e-12)
        R = R @ so3.exp(0.5 * (batch.gyro[k] + batch.gyro[k + 1]) * 0.005)
