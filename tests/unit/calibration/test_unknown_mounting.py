"""A mounting that no source gives: calibrated from the recording, or else what the turns tell."""

import numpy as np
import pytest

from heliograph.calibration import align_mounting, mounting
from heliograph.config import RunConfig
from heliograph.errors import CalibrationError
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate


@pytest.fixture(scope="module")
def drive():
    simulation = simulate(SCENARIOS["room"].thinned(beams=16, columns=180, duration=6.0), 4)
    return list(simulation), simulation.rig.T_imu_lidar


def errors(rig, T):
    """Rotation's [rad] and lever arm's [m]."""
    turn = np.linalg.norm(so3.log(rig.T_imu_lidar[:3, :3].T @ T[:3, :3]))
    return float(turn), float(np.linalg.norm(rig.T_imu_lidar[:3, 3] - T[:3, 3]))


def test_unknown_mounting_is_calibrated_within_its_sigma(drive):
    messages, T = drive
    alignment = align_mounting(lambda: iter(messages), RunConfig())
    turn, shift = errors(alignment.rig, T)
    assert alignment.rig.known and alignment.rig.source == "calibrated from the recording"
    assert turn < min(np.radians(0.1), 3.0 * alignment.rig.sigma_rotation)
    assert shift < min(0.02, 3.0 * alignment.rig.sigma_translation)
    (event,) = alignment.events
    assert event.code == "mounting-aligned" and "clock" not in event.message and "run.json" in event.message


def test_calibration_that_fails_leaves_what_the_filter_finds(drive, monkeypatch):
    def fails(stream, rig, config, *, threads):
        next(iter(stream))
        raise CalibrationError("LiDAR and IMU do not fit each other")

    monkeypatch.setattr(mounting, "calibrate", fails)
    monkeypatch.setattr(mounting, "_MAX_PASSES", 1)
    messages, T = drive
    alignment = align_mounting(lambda: iter(messages), RunConfig())
    assert alignment.rig.source == "aligned from the data" and errors(alignment.rig, T)[0] < np.radians(1.0)
