"""The KITTI drive that README of the shared data describes, read as a user would."""

from pathlib import Path

import numpy as np
import pytest

from heliograph.data import GnssFix, ImuBatch, Scan
from heliograph.io import inspect_recording, open_recording

pytestmark = pytest.mark.real

R_VELO_IMU = np.array(
    [
        [0.9999976, 0.0007553071, -0.002035826],
        [-0.0007854027, 0.9998898, -0.01482298],
        [0.002024406, 0.01482454, 0.9998881],
    ]
)
t_velo_imu = np.array([-0.8086759, 0.3195559, -0.7997231])


@pytest.fixture(scope="module")
def recording_path(shared_data: Path) -> Path:
    return shared_data / "kitti_0005" / "recording"


def test_kitti_inferences_match_its_description(recording_path):
    with open_recording(recording_path) as recording:
        values = {i.name: i.value for i in recording.inferences}
        T_velo_imu = np.linalg.inv(recording.rig.T_imu_lidar)
    assert values["point time field"] == "time"
    assert values["point time unit"] == "s"
    assert values["scan stamp"] == "the sweep's start"
    assert values["accelerometer unit"] == "m/s^2"
    assert values["sweep period"] == "0.1036 s"
    assert recording.rig.known
    assert np.allclose(T_velo_imu[:3, :3], R_VELO_IMU, atol=1e-5)  # KITTI's file is rounded
    assert np.allclose(T_velo_imu[:3, 3], t_velo_imu, atol=1e-5)


def test_kitti_streams_every_message_in_causal_order(recording_path):
    with open_recording(recording_path) as recording:
        items = list(recording.stream())
        total = recording.total_scans
    received = [item.received_ns for item in items]
    scans = [item for item in items if isinstance(item, Scan)]
    assert received == sorted(received)
    assert len(scans) == total == 100
    assert sum(len(item) for item in items if isinstance(item, ImuBatch)) == 100
    assert sum(isinstance(item, GnssFix) for item in items) == 100
    assert 100_000 < len(scans[0]) < 130_000
    assert all(103_000_000 < scan.end_ns - scan.stamp_ns < 104_000_000 for scan in scans)
    first_imu = next(item for item in items if isinstance(item, ImuBatch)).stamps_ns[0]
    assert first_imu - scans[0].stamp_ns == 51_800_000


def test_kitti_report_counts_what_is_there(recording_path):
    with open_recording(recording_path) as recording:
        report = inspect_recording(recording)
    streams = {stream.sensor: stream for stream in report.streams}
    assert streams["lidar"].count == streams["imu"].count == 100
    assert streams["lidar"].rate_hz == pytest.approx(9.6525, abs=1e-3)
    assert report.has_orientation
    assert report.valid_fixes == 100
    assert streams["gnss"].frame == "gnss"
    assert report.events == ()
