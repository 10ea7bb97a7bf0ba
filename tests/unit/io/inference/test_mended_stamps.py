from itertools import pairwise

import numpy as np
import pytest

from heliograph.data import ImuBatch, Scan
from heliograph.io.inference.imu_stamps import EvenStamps, behind_imu, even_period, uneven_period
from heliograph.io.inference.mixed import of_one_frame
from heliograph.io.inference.mounting import FrameTree
from heliograph.io.inference.sweeps import SweepJoiner, parts_of_a_sweep
from heliograph.io.raw import RawCloud, RawImu

PERIOD = 4_000_000


def samples(stamps, frames=("imu",)):
    rng = np.random.default_rng(3)
    return [
        RawImu(topic="/imu", received_ns=int(t), stamp_ns=int(t), frame_id=frames[k % len(frames)],
               gyro=tuple(rng.normal(0, 0.01, 3)), accel=(0.0, 0.0, 9.8))
        for k, t in enumerate(stamps)
    ]  # fmt: skip


def jittered(count=1000, *, seed=1):
    """Stamps of arrival: now and then everything waits up to 100 ms and then comes at once."""
    rng, release, found = np.random.default_rng(seed), 0, []
    for true in PERIOD * np.arange(count):
        if true >= release:
            release = true + int(rng.exponential(12e6)) if rng.random() < 0.9 else true + 100_000_000
        found.append(max(true, release, found[-1] + 2000 if found else 0))
    return np.array(found)


def test_bunched_stamps_are_known_and_spread_to_where_they_belong():
    stamps = jittered()
    assert uneven_period(samples(stamps[:400])) is not None
    period = even_period(stamps, PERIOD)
    assert period == pytest.approx(PERIOD, rel=2e-3)
    even = EvenStamps(period)
    found = np.array([even.at(int(t)) for t in stamps])
    assert np.all(np.diff(found) > 0)
    error = found - PERIOD * np.arange(len(stamps))
    assert np.abs(error[100:]).mean() < 3e6 < np.abs(stamps - PERIOD * np.arange(len(stamps))).mean()


def test_equal_stamps_of_different_samples_are_bunched_too():
    assert uneven_period(samples(np.repeat(40_000_000 * np.arange(40), 10))) == pytest.approx(PERIOD, rel=0.05)


@pytest.mark.parametrize("jitter", [0.0, 0.3e6, 1.0e6])
def test_a_sensors_own_jitter_is_left_alone(jitter):
    stamps = PERIOD * np.arange(400) + np.random.default_rng(2).normal(0, jitter, 400)
    assert uneven_period(samples(np.sort(stamps))) is None


def test_lost_samples_are_left_alone():
    kept = np.random.default_rng(5).random(800) < 0.6
    assert uneven_period(samples((PERIOD * np.arange(800))[kept][:400])) is None


def test_of_two_imus_on_a_topic_the_one_that_tf_links_is_used_else_the_first():
    mixed = samples(PERIOD * np.arange(100), frames=("imu_link", "camera_imu"))
    used, events = of_one_frame(mixed, "IMU", FrameTree([]), "lidar")
    assert {m.frame_id for m in used} == {"imu_link"} and [event.code for event in events] == ["imu-frames"]
    used, _ = of_one_frame(mixed, "IMU", FrameTree([]), "camera_imu")
    assert {m.frame_id for m in used} == {"camera_imu"}
    same, events = of_one_frame(mixed[::2], "IMU", FrameTree([]), "lidar")
    assert len(same) == 50 and not events


def sector(begin, end, stamp_ns):
    azimuth = np.linspace(begin, end, 300, endpoint=False)
    columns = {"x": 5 * np.cos(azimuth), "y": 5 * np.sin(azimuth), "z": np.zeros(300)}
    columns = {name: values.astype(np.float32) for name, values in columns.items()}
    return RawCloud(topic="/points", received_ns=stamp_ns, stamp_ns=stamp_ns, frame_id="lidar", columns=columns)


def test_eighths_of_a_turn_are_parts_and_whole_turns_are_not():
    step = 2 * np.pi / 8
    eighths = [sector(k * step, (k + 1) * step, 12_500_000 * k) for k in range(12)]
    assert parts_of_a_sweep(eighths, 12_500_000) == 8
    whole = [sector(0.0, 2 * np.pi, 33_000_000 * k) for k in range(12)]
    assert parts_of_a_sweep(whole, 33_000_000) == 1
    assert parts_of_a_sweep(eighths, 100_000_000) == 1


def part(k, *, points=10):
    start = 12_500_000 * k
    offsets = np.linspace(0, 12e6, points).astype(np.int32)
    return Scan(
        stamp_ns=start,
        header_stamp_ns=start,
        received_ns=start + 12_500_000,
        end_ns=start + 12_000_000,
        points=np.full((points, 3), float(k), np.float32),
        offsets_ns=offsets,
    )


def test_joined_parts_keep_the_time_of_every_point():
    scans = list(SweepJoiner(12_500_000).joined(iter([part(k) for k in range(20)])))
    assert [len(scan) for scan in scans] == [80, 80, 40]
    first = scans[0]
    assert first.stamp_ns == first.header_stamp_ns == 0 and first.end_ns == 99_500_000
    assert np.all(np.abs(first.offsets_ns - 12_500_000 * first.points[:, 0]) <= 12_000_000)


def batch(first, last, received):
    stamps = np.arange(first, last, 5_000_000, dtype=np.int64)
    return ImuBatch(
        stamps_ns=stamps, gyro=np.zeros((len(stamps), 3)), accel=np.zeros((len(stamps), 3)), received_ns=received
    )


def test_a_scan_waits_for_samples_that_lie_further_on_and_not_for_ever():
    scans = [part(0), part(8), part(400)]
    stream = [scans[0], scans[1], batch(0, 200_000_000, 160_000_000), scans[2]]
    found = list(behind_imu(iter(stream), patience_ns=300_000_000))
    assert [type(m).__name__ for m in found] == ["ImuBatch", "Scan", "Scan", "Scan"]
    assert all(a.received_ns <= b.received_ns for a, b in pairwise(found))
    quiet = [part(0), part(40), part(80)]
    assert [m.stamp_ns for m in behind_imu(iter(quiet), patience_ns=300_000_000)] == [m.stamp_ns for m in quiet]
