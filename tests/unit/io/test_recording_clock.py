"""The clock of an extrinsic file is applied to the samples of a recording, and to nothing else."""

import numpy as np
import pytest

from heliograph.config import InputConfig
from heliograph.data import ImuBatch, Rig, Scan
from heliograph.errors import ConfigError
from heliograph.io import open_recording
from heliograph.io.files.extrinsic import write_extrinsic
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.write import write_recording

SCENARIO = SCENARIOS["calibration"].thinned(beams=4, columns=64, duration=1.5)
LATE = SCENARIO.varied(imu={"clock_offset": 0.021, "clock_drift_ppm": 40.0})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("late"), LATE, 1).folder


def messages(folder, extrinsic=""):
    with open_recording(folder, InputConfig(extrinsic=str(extrinsic))) as recording:
        stream = list(recording.stream())
    imu = np.concatenate([m.stamps_ns for m in stream if isinstance(m, ImuBatch)])
    return imu, [m.stamp_ns for m in stream if isinstance(m, Scan)]


def test_simulated_imu_is_stamped_by_its_own_clock():
    sensors = simulate(LATE, 1)
    late = (sensors.imu_clock_ns - sensors.imu_stamps_ns) * 1e-9
    np.testing.assert_allclose(late[[0, -1]], [0.021, 0.021 + 1.5 * 40e-6], atol=2e-9)
    batches = [m for m in sensors if isinstance(m, ImuBatch)]
    assert np.array_equal(np.concatenate([b.stamps_ns for b in batches]), sensors.imu_clock_ns)
    assert all(b.received_ns <= sensors.imu_stamps_ns[-1] for b in batches)


def test_recording_brings_the_samples_to_the_lidars_clock(folder, tmp_path):
    sensors = simulate(LATE, 1)
    write_extrinsic(tmp_path / "e.toml", sensors.rig, {})
    raw, raw_scans = messages(folder)
    corrected, scans = messages(folder, tmp_path / "e.toml")
    assert np.array_equal(raw, sensors.imu_clock_ns)
    assert np.abs(corrected - sensors.imu_stamps_ns).max() <= 1
    assert scans == raw_scans
    with open_recording(folder, InputConfig(extrinsic=str(tmp_path / "e.toml"))) as recording:
        [clock] = [inference.value for inference in recording.inferences if inference.name == "imu clock"]
    assert clock == "+21.000 ms, +40.0 ppm"


def test_clock_found_long_ago_is_refused(folder, tmp_path):
    sensors = simulate(LATE, 1)
    clock = sensors.clock
    old = type(clock)(offset=clock.offset, drift=clock.drift, reference_ns=clock.reference_ns - 86_400_000_000_000)
    write_extrinsic(tmp_path / "e.toml", Rig(T_imu_lidar=np.eye(4), source="x", clock=old), {})
    with pytest.raises(ConfigError, match=r"found 24\.0 h from this recording.* drift_ppm = 0"):
        messages(folder, tmp_path / "e.toml")
