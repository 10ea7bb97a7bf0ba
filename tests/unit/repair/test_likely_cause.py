"""The cause that is named where an IMU contradicts the LiDAR and nothing could be mended."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.checks.evidence import gather
from heliograph.lie import so3
from heliograph.repair.cause import clock_step, likely_cause
from heliograph.sim import SCENARIOS
from imu_records import made_records


@pytest.fixture(scope="module")
def sound():
    scenario = SCENARIOS["room"].varied(gait={"roll_deg": 10.0, "pitch_deg": 8.0, "yaw_deg": 12.0, "bounce": 0.05})
    return made_records(scenario.thinned(duration=20.0), seed=3)


def cause(records, change=lambda imu: imu):
    imu, motion = records
    return likely_cause(gather(change(imu), motion))


def late(seconds):
    """The IMU's stamps moved by a function of the time since the start."""

    def change(imu):
        at = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
        return replace(imu, stamps_ns=imu.stamps_ns + np.rint(1e9 * seconds(at)).astype(np.int64))

    return change


def test_sound_recording_has_no_cause(sound):
    assert cause(sound) == ""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("place", ["room", "warehouse"])
def test_sound_recordings_have_no_cause_whatever_the_seed(place, seed):
    assert cause(made_records(SCENARIOS[place].thinned(duration=16.0), seed=300 + seed)) == ""


@pytest.mark.parametrize("drift", [1e-3, 3e-3])
def test_drift_of_the_clock_is_named_with_its_rate(sound, drift):
    said = cause(sound, late(lambda at: drift * at))
    assert "runs away from the LiDAR's" in said and "calibrate" in said
    assert float(said.partition("by ")[2].partition(" ms")[0]) == pytest.approx(1e3 * drift, rel=0.15)


@pytest.mark.parametrize("offset", [0.07, 0.3, -0.7, 2.5])
def test_constant_offset_is_no_step(sound, offset):
    imu, motion = sound
    assert clock_step(gather(late(lambda _: offset)(imu), motion)) == ""


@pytest.mark.parametrize("step", [0.1, 0.15, 0.3])
def test_step_of_the_clock_is_named_with_its_size(sound, step):
    said = cause(sound, late(lambda at: step * (at > 9.0)))
    assert "steps by" in said and "NTP" in said
    assert float(said.partition("steps by ")[2].partition(" s")[0]) == pytest.approx(step, abs=0.02)


@pytest.mark.parametrize("scale", [0.9, 1.06])
def test_scale_of_the_gyroscope_is_named(sound, scale):
    said = cause(sound, lambda imu: replace(imu, gyro=scale * imu.gyro))
    assert f"{100 * (scale - 1):+.1f}"[:3] in said and "range setting" in said


def test_wrong_mounting_is_named(sound):
    imu, motion = sound
    T = motion.rig.T_imu_lidar.copy()
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    T[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ T[:3, :3]
    said = cause((imu, replace(motion, rig=replace(motion.rig, T_imu_lidar=T))))
    assert "tf_static is off by" in said and "mount" in said


@pytest.mark.parametrize("degrees", [2.0, 4.0])
def test_mounting_that_is_off_by_little_is_named_where_something_must_explain_it(sound, degrees):
    imu, motion = sound
    T = motion.rig.T_imu_lidar.copy()
    T[:3, :3] = T[:3, :3] @ so3.exp(np.radians([0.0, degrees, 0.0]))
    said = cause((imu, replace(motion, rig=replace(motion.rig, T_imu_lidar=T))))
    assert "tf_static is off by" in said and "mounting" in said


def test_wrong_lever_arm_is_named(sound):
    imu, motion = sound
    T = motion.rig.T_imu_lidar.copy()
    T[:3, 3] += [0.0, 0.0, -1.0]
    said = cause((imu, replace(motion, rig=replace(motion.rig, T_imu_lidar=T))))
    assert "is off by 0.9" in said and "lever arm" in said


def test_mirrored_cloud_is_named(sound):
    mirror = np.array([1.0, -1.0, 1.0])
    said = cause(sound, lambda imu: replace(imu, gyro=-imu.gyro * mirror, accel=imu.accel * mirror))
    assert "mirror image" in said and "right-handed" in said
