"""The inertial checks on recordings of real sensors: no alarm without a cause."""

import numpy as np
import pytest

from heliograph.checks import ImuRecord, check_imu
from heliograph.config import RunConfig
from heliograph.errors import MissingDependencyError
from heliograph.examination import examine_imu
from heliograph.io import open_recording

pytestmark = pytest.mark.real


def verdicts(findings):
    return {finding.code: finding.verdict for finding in findings}


@pytest.mark.slow
def test_kitti_drive_has_slow_and_early_inertial_data_and_sound_axes(shared_data):
    """Its IMU comes at 10 Hz; that it does not match the LiDAR in time is what others found, too (see data/README)."""
    with open_recording(shared_data / "kitti_0005" / "recording") as recording:
        report = examine_imu(recording, RunConfig())
    found = {finding.code: finding for finding in report.findings}
    assert {code for code, finding in found.items() if finding.verdict == "warn"} == {"imu-rate", "clock-offset"}
    assert found["clock-offset"].numbers[0].value == pytest.approx(0.044, abs=0.01)
    assert not [code for code, finding in found.items() if finding.verdict == "fail"]
    for code in ("accel-unit", "gyro-unit", "gyro-axes", "accel-axes", "mounting", "imu-prediction"):
        assert found[code].verdict == "ok", found[code].evidence


def test_kitti_100_hz_table_is_sound(shared_data):
    rows = np.loadtxt(shared_data / "kitti_00" / "imu.txt", skiprows=1)[1:]  # the first row is a stub before a gap
    stamps = np.round(rows[:, 0] * 1e9).astype(np.int64)
    imu = ImuRecord(
        stamps_ns=stamps,
        received_ns=stamps,
        accel=np.ascontiguousarray(rows[:, 2:5]),
        gyro=np.ascontiguousarray(rows[:, 5:8]),
    )
    assert set(verdicts(check_imu(imu)).values()) == {"ok", "unknown"}
    spoilt = ImuRecord(stamps_ns=stamps, received_ns=stamps, gyro=imu.gyro.copy(), accel=imu.accel / 9.80665)
    assert verdicts(check_imu(spoilt))["accel-unit"] == "fail"


@pytest.mark.parametrize(
    "name", ["512x10_raw.bag", "OS-0-32-U1_v2.2.0_1024x10.pcap", "OS-1-128_v2.3.0_1024x10_lb_n3.pcap"]
)
def test_short_samples_of_real_sensors_raise_no_alarm(shared_data, name):
    pytest.importorskip("ouster", reason="needs ouster-sdk")
    try:
        with open_recording(shared_data / "formats" / name) as recording:
            report = examine_imu(recording, RunConfig())
    except MissingDependencyError as error:
        pytest.skip(str(error))
    assert set(verdicts(report.findings).values()) == {"ok", "unknown"}
