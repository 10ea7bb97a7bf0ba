"""The LiDAR on the IMU: file, tf, maker, unknown - in this order."""

import numpy as np
import pytest

from heliograph.io.inference.mounting import FrameTree, find_mounting
from heliograph.io.raw import RawCloud, RawImu, RawTransform


def edge(parent, child, translation=(0.0, 0.0, 0.0), yaw_deg=0.0, static=True):
    c, s = np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))
    T = np.array([[c, -s, 0, translation[0]], [s, c, 0, translation[1]], [0, 0, 1, translation[2]], [0, 0, 0, 1.0]])
    return RawTransform(topic="/tf_static", received_ns=0, parent=parent, child=child, T_parent_child=T, static=static)


def cloud(frame="lidar", points=None, topic="/points", layout="PointCloud2"):
    points = np.ones((3, 3), np.float32) if points is None else points
    columns = dict(zip("xyz", points.T, strict=True))
    return RawCloud(topic=topic, received_ns=0, stamp_ns=0, frame_id=frame, columns=columns, layout=layout)


def sample(frame="imu", topic="/imu"):
    return RawImu(topic=topic, received_ns=0, stamp_ns=0, frame_id=frame, gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 9.8))


def mounting(edges=(), factory=None, extrinsic="", clouds=None, samples=None):
    clouds = [cloud()] if clouds is None else clouds
    samples = [sample()] if samples is None else samples
    return find_mounting(clouds, samples, FrameTree(edges), factory, extrinsic)


def test_tf_is_walked_through_both_directions():
    found = mounting(
        [
            edge("base", "imu", (1.0, 0.0, 0.0), 90.0),
            edge("base", "mast", (0.0, 0.0, 2.0)),
            edge("mast", "lidar", (1.0, 3.0, 0.0)),
        ]
    )
    assert found.rig.known
    assert found.rig.source == "tf_static"
    assert found.events == ()
    # The lidar's origin is at (1, 3, 2) in base; the IMU, a metre ahead, is turned by a quarter: x_imu = y_base.
    assert np.allclose(found.rig.T_imu_lidar[:3, 3], [3.0, 0.0, 2.0])
    assert "imu - base - mast - lidar" in found.inferences[0].evidence


def test_leading_slash_of_old_frames_does_not_matter():
    found = mounting([edge("imu", "lidar", (0.1, 0.2, 0.3))], clouds=[cloud("/lidar")])
    assert np.allclose(found.rig.T_imu_lidar[:3, 3], [0.1, 0.2, 0.3])


def test_moving_link_is_used_with_a_warning():
    found = mounting([edge("imu", "lidar", static=False)])
    assert found.rig.source == "tf"
    assert [e.code for e in found.events] == ["moving-mount"]


@pytest.mark.parametrize("edges", [(), (edge("base", "camera"),)])
def test_unlinked_frames_are_unknown_with_wide_covariance(edges):
    found = mounting(edges)
    assert not found.rig.known
    assert np.array_equal(found.rig.T_imu_lidar, np.eye(4))
    assert found.rig.sigma_rotation == pytest.approx(np.pi)
    assert found.rig.sigma_translation == 0.3
    assert [e.code for e in found.events] == ["unknown-mount"]
    assert "--extrinsic" in found.events[0].message


def test_equal_frame_names_are_not_taken_as_identity():
    assert not mounting(clouds=[cloud("sensor")], samples=[sample("sensor")]).rig.known


def test_container_metadata_are_used_where_tf_is_silent():
    T = np.eye(4)
    T[0, 3] = 0.5
    found = mounting(factory=(T, "Ouster OS-1"))
    assert found.rig.known
    assert found.rig.source == "factory, Ouster OS-1"
    assert np.array_equal(found.rig.T_imu_lidar, T)


def directions(rng, azimuth_deg, elevation_deg, n=3000):
    azimuth, elevation = np.deg2rad(rng.uniform(*azimuth_deg, n)), np.deg2rad(rng.uniform(*elevation_deg, n))
    xyz = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    return (5.0 * xyz).astype(np.float32)


@pytest.mark.parametrize(
    ("view", "name", "translation"),
    [
        (((-180, 180), (-7, 52)), "Livox Mid-360", (-0.011, -0.02329, 0.04412)),
        (((-35, 35), (-36, 36)), "Livox Avia", (0.04165, 0.02326, -0.0284)),
        (((-60, 60), (-12.5, 12.5)), "Livox HAP", (0.0, 0.0, 0.0)),
    ],
)
def test_livox_with_its_own_imu_gets_its_maker_s_figure(rng, view, name, translation):
    clouds = [cloud("livox_frame", directions(rng, *view), layout="livox/CustomMsg")]
    found = mounting(clouds=clouds, samples=[sample("livox_frame", "/livox/imu")])
    assert found.rig.source == f"factory, {name}"
    assert np.allclose(found.rig.T_imu_lidar[:3, 3], translation)
    assert np.array_equal(found.rig.T_imu_lidar[:3, :3], np.eye(3))


@pytest.mark.parametrize(
    ("view", "imu"), [(((-180, 180), (-7, 52)), sample()), (((-10, 10), (-5, 5)), sample("livox_frame"))]
)
def test_foreign_imu_or_unknown_livox_is_not_guessed(rng, view, imu):
    clouds = [cloud("livox_frame", directions(rng, *view), layout="livox/CustomMsg")]
    assert not mounting(clouds=clouds, samples=[imu]).rig.known


def test_single_sensor_is_its_own_body():
    found = mounting(samples=[])
    assert found.rig.known
    assert found.events == ()


QUATERNION = "translation = [0.1, 0.2, 0.3]\nrotation = [0.0, 0.0, 0.7071067811865476, 0.7071067811865476]\n"
MATRIX = "[T_imu_lidar]\ntranslation = [0.1, 0.2, 0.3]\nrotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]\n"


@pytest.mark.parametrize("text", [QUATERNION, MATRIX])
def test_extrinsic_file_overrules_tf(text, tmp_path):
    (tmp_path / "calib.toml").write_text(text)
    found = mounting([edge("imu", "lidar")], extrinsic=str(tmp_path / "calib.toml"))
    assert np.allclose(found.rig.T_imu_lidar @ [1.0, 0.0, 0.0, 1.0], [0.1, 1.2, 0.3, 1.0])
    assert found.inferences[0].source == "override"
