"""Speeds from topics: odometry, twists and joints, and each thing that cannot be told in one line."""

import numpy as np
import pytest
from tests.bags import T0, drive, header

from heliograph.config import WheelConfig
from heliograph.errors import ConfigError, DataError, TopicError
from heliograph.io import open_recording
from heliograph.io.files.wheels import read_wheel_speeds
from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording

ODOMETRY, TWIST, JOINTS = "nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/JointState"
STEP = 20_000_000


def twist(store, v):
    vector = store.types["geometry_msgs/msg/Vector3"]
    return store.types["geometry_msgs/msg/Twist"](vector(*(float(x) for x in v)), vector(0.0, 0.0, 0.0))


def odometry(stamp_ns, v, x=0.0, variance=0.0):
    def make(store):
        types = store.types
        pose = types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](x, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        )
        covariance = variance * np.eye(6).ravel()
        return types[ODOMETRY](
            header(store, stamp_ns, "odom"), "base",
            types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            types["geometry_msgs/msg/TwistWithCovariance"](twist(store, v), covariance),
        )  # fmt: skip

    return make


def twist_stamped(stamp_ns, v):
    return lambda store: store.types[TWIST](header(store, stamp_ns, "base"), twist(store, v))


def joints(stamp_ns, names, rates):
    def make(store):
        empty = np.zeros(0)
        return store.types[JOINTS](header(store, stamp_ns, ""), names, np.zeros(len(names)), np.array(rates), empty)

    return make


def speeds_of(tmp_path, kind, makers, *, ros=2, topic="/speed", **config):
    bag = drive(scans=4)
    for k, make in enumerate(makers):
        bag.add("/speed", kind, T0 + k * STEP, make)
    path = bag.mcap(tmp_path / "drive.mcap") if ros == 2 else bag.ros1(tmp_path / "drive.bag")
    with open_recording(path) as recording:
        return recording.speeds(WheelConfig(topic=topic, **config))


@pytest.mark.parametrize("ros", [1, 2])
def test_an_odometrys_twist_is_taken_with_its_mounting_and_noise(tmp_path, ros):
    makers = [odometry(T0 + k * STEP, (1.0 + 0.1 * k, 0.0, 0.0), variance=0.04) for k in range(10)]
    speeds = speeds_of(tmp_path, ODOMETRY, makers, ros=ros)
    np.testing.assert_array_equal(speeds.stamps_ns, T0 + STEP * np.arange(10))
    np.testing.assert_allclose(speeds.v_body[:, 0], 1.0 + 0.1 * np.arange(10))
    assert np.isnan(speeds.v_body[:, 1:]).all()  # zero throughout: the driver's model, not a measurement
    np.testing.assert_allclose(speeds.sigma, 0.2)
    np.testing.assert_allclose(speeds.T_imu_vehicle[:3, 3], [-0.1, 0.0, -0.2])


def test_twists_of_legs_keep_all_axes_and_what_runs_back_is_left_out(tmp_path):
    stamps = [0, 1, 2, 2, 1, 3]
    makers = [twist_stamped(T0 + k * STEP, (0.5, 0.1, -0.02)) for k in stamps]
    speeds = speeds_of(tmp_path, TWIST, makers, clock_offset=0.5)
    np.testing.assert_array_equal(speeds.stamps_ns, T0 - 500_000_000 + STEP * np.arange(4))
    np.testing.assert_allclose(speeds.v_body, np.tile([0.5, 0.1, -0.02], (4, 1)))


@pytest.mark.parametrize("ros", [1, 2])
def test_joints_turn_wheels_of_a_radius(tmp_path, ros):
    makers = [joints(T0 + k * STEP, ["left", "right", "arm"], [10.0, -12.0, 3.0]) for k in range(5)]
    speeds = speeds_of(tmp_path, JOINTS, makers, ros=ros, joints=("left", "-right"), radius=0.1)
    np.testing.assert_allclose(speeds.v_body[:, 0], 1.1)


@pytest.mark.parametrize(
    ("kind", "make", "config", "error", "message"),
    [
        (ODOMETRY, lambda k: odometry(T0 + k * STEP, (0.0, 0.0, 0.0), x=float(k)), {}, DataError, "driver leaves it"),
        (TWIST, lambda k: twist_stamped(T0 + k * STEP, (0.0, 0.0, 0.0)), {}, DataError, "all its speeds are zero"),
        (TWIST, lambda k: twist_stamped(T0 + k * STEP, (np.nan, 0.0, 0.0)), {}, DataError, "no usable speed"),
        (TWIST, lambda k: twist_stamped(T0 + k * STEP, (3600.0, 0.0, 0.0)), {}, DataError, "metres a second"),
        (JOINTS, lambda k: joints(T0 + k * STEP, ["l"], [1.0]), {}, ConfigError, "give wheels.joints"),
        (JOINTS, lambda k: joints(T0 + k * STEP, ["l"], [1.0]), {"joints": ("r",), "radius": 1.0}, ConfigError, "no"),
        (TWIST, lambda k: twist_stamped(T0 + k * STEP, (1.0, 0.0, 0.0)), {"topic": "/sped"}, TopicError, "/speed"),
    ],
)  # fmt: skip
def test_speeds_that_cannot_be_are_told_in_one_line(tmp_path, kind, make, config, error, message):
    with pytest.raises(error, match=message) as caught:
        speeds_of(tmp_path, kind, [make(k) for k in range(5)], **config)
    assert "\n" not in str(caught.value)


def test_a_simulated_recordings_topic_is_what_its_table_holds(tmp_path):
    scenario = SCENARIOS["tunnel-wheels"].thinned(beams=2, columns=16, duration=5.0)
    write_recording(tmp_path, scenario, 3)
    table = read_wheel_speeds(tmp_path / "wheels.csv")
    with open_recording(tmp_path) as recording:
        speeds = recording.speeds(WheelConfig(topic="/wheels/odometry"))
    np.testing.assert_array_equal(speeds.stamps_ns, table.stamps_ns)
    np.testing.assert_allclose(speeds.v_body, table.v_body, atol=1e-4)
    np.testing.assert_allclose(speeds.T_imu_vehicle, np.eye(4), atol=1e-9)
