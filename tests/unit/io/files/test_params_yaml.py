"""Mountings in other systems' parameter files mean what those systems take them for."""

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph.io import read_extrinsic
from heliograph.lie import se3

R = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]  # turns by 90 deg about z
FAST_LIO = f"""
common:
    lid_topic: "/livox/lidar"
    time_offset_lidar_to_imu: 0.02
mapping:
    extrinsic_T: [ 0.1, 0.2, 0.3 ]
    extrinsic_R: {R}
"""
ROS_2 = f"""
/**:
    ros__parameters:
        mapping.extrinsic_est_en: false
        mapping:
            extrinsic_T: [ 0.1, 0.2, 0.3 ]
            extrinsic_R: {R}
"""
LIO_SAM = f"""
lio_sam:
  imuGravity: 9.80511
  extrinsicTrans: [0.1, 0.2, 0.3]
  extrinsicRot: {R}
  extrinsicRPY: {R}
"""


def stated():
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.reshape(R, (3, 3)), [0.1, 0.2, 0.3]
    return T


def read(tmp_path, text, name="params.yaml"):
    (tmp_path / name).write_text(text)
    return read_extrinsic(tmp_path / name)


@pytest.mark.parametrize("text", [FAST_LIO, ROS_2, "%YAML:1.0\n" + FAST_LIO])
def test_fast_lio_states_the_lidar_in_the_imus_frame(tmp_path, text):
    np.testing.assert_allclose(read(tmp_path, text).T_imu_lidar, stated(), atol=1e-15)


def test_fast_lio_offset_is_what_the_imus_clock_shows_more(tmp_path):
    clock = read(tmp_path, FAST_LIO).clock
    assert clock.offset == 0.02
    assert clock.imu_time(np.array([1_000_000_000]))[0] == 1_020_000_000


def test_lio_sam_states_the_imu_in_the_lidars_frame(tmp_path):
    rig = read(tmp_path, LIO_SAM, "params.yml")
    np.testing.assert_allclose(rig.T_imu_lidar, se3.inverse(stated()), atol=1e-15)
    # A point at the LiDAR's origin lies where LIO-SAM puts the LiDAR in the IMU's frame: -R^T t.
    np.testing.assert_allclose(rig.T_imu_lidar[:3, 3], [-0.2, 0.1, -0.3], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mapping: {}", "states no mounting; expected extrinsic_T with extrinsic_R"),
        (FAST_LIO + LIO_SAM, "states two mountings"),
        ("a: {extrinsic_T: [0, 0, 0]}", "has no 'extrinsic_R'"),
        (f"extrinsic_T: [0, 0]\nextrinsic_R: {R}", "'extrinsic_T' must be 3 finite numbers"),
        (f"extrinsic_T: [0, 0, .nan]\nextrinsic_R: {R}", "must be 3 finite numbers"),
        ("extrinsic_T: [0, 0, 0]\nextrinsic_R: [1, 0, 0, 0, 1, 0, 0, 0, -1]", "the rotation is a mirror"),
        (f"a: {{extrinsic_T: [0, 0, 1]}}\nb: {{extrinsic_T: [0, 0, 2]}}\nextrinsic_R: {R}", "is given twice"),
        ("a: [1, 2", "is not YAML"),
        ("a: &a [*a]", "states no mounting"),
        ("x" * 1_100_000, "too many for a file of parameters"),
    ],
)
def test_file_without_a_mounting_is_one_line(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_extrinsic(tmp_path / "none.yaml")


def test_a_number_beyond_all_is_refused(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(FAST_LIO.replace("0.1, 0.2", f"{'9' * 400}, 0.2"))
    with pytest.raises(ConfigError, match="finite numbers"):
        read_extrinsic(path)
