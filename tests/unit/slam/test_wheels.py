"""Wheels beside a LiDAR that sees nothing along the way: scale, slip, and wheels that are wrong."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Keyframe, WheelSpeeds
from heliograph.errors import FormatError
from heliograph.io.files.wheels import read_wheel_speeds
from heliograph.slam import BackEnd, KeyframeStore
from heliograph.slam.inertial_factors import seen_covariance

SPEED, RATE, STEP_NS, SEEN = 3.0, 200, 400_000_000, 12


def keyframes(rng, count, *, drift=0.004):
    """Keyframes 1.2 m apart on a straight way; behind the first few the LiDAR sees nothing along it."""
    blind = np.diag([1e6, 1e6, 1e6, 0.0, 1e6, 1e6])
    pose, found = np.eye(4), []
    for k in range(count):
        T = pose.copy()
        T[0, 3] = SPEED * 1e-9 * STEP_NS * k * (1.0 + (drift if k > SEEN else 0.0) * max(k - SEEN, 0))
        stamps = np.arange((k - 1) * STEP_NS, k * STEP_NS + 1, 10**9 // RATE) + 10**9
        sigma = np.array([1e-4] * 3 + [0.002 if k <= SEEN else 0.05, 0.002, 0.002])
        found.append(Keyframe(
            index=k, stamp_ns=10**9 + k * STEP_NS, T_odom_imu=T, v_odom=np.array([SPEED, 0.0, 0.0]),
            gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g_odom=np.array([0.0, 0.0, -9.80665]),
            step_covariance=np.diag(sigma**2) if k else np.zeros((6, 6)),
            lidar_information=blind if k > SEEN else 1e6 * np.eye(6),
            points_imu=rng.normal(size=(50, 3)).astype(np.float32), intensity=None,
            imu=ImuBatch(
                stamps_ns=stamps, gyro=1e-4 * rng.normal(size=(len(stamps), 3)),
                accel=np.array([0.0, 0.0, 9.80665]) + 0.02 * rng.normal(size=(len(stamps), 3)),
                received_ns=int(stamps[-1]),
            ),
        ))  # fmt: skip
    return found


def speeds(rng, count, factor):
    stamps = 10**9 - 10**8 + np.arange(0, count * STEP_NS + 2 * 10**8, 2 * 10**7)
    v = np.full((len(stamps), 3), np.nan)
    v[:, 0] = SPEED * factor + 0.02 * rng.normal(size=len(stamps))
    return WheelSpeeds(stamps_ns=stamps, v_body=v, received_ns=int(stamps[-1]))


def through(tmp_path, rng, count, wheels, **drift):
    config = RunConfig()
    back_end = BackEnd(replace(config, slam=replace(config.slam, loops=False)), KeyframeStore.create(tmp_path))
    if wheels is not None:
        back_end.wheels.observe(wheels)
    for keyframe in keyframes(rng, count, **drift):
        back_end.add(keyframe)
    back_end.store.close()
    return back_end


def test_wheels_carry_the_way_where_the_lidar_is_blind(tmp_path, rng):
    count = 60
    back_end = through(tmp_path, rng, count, speeds(rng, count, 1.0 / 1.03))
    account = back_end.account().wheels
    length = SPEED * 1e-9 * STEP_NS * (count - 1)
    assert account.scale == pytest.approx(1.03, abs=0.003)
    assert abs(account.scale - 1.03) < 4.0 * account.scale_sigma
    assert back_end.T_map_imu[-1][0, 3] == pytest.approx(length, abs=0.005 * length)
    assert back_end.moves


def test_slip_is_left_out_and_said(tmp_path, rng):
    count = 40
    wheels = speeds(rng, count, 1.0)
    v = wheels.v_body.copy()
    slipping = (wheels.stamps_ns > 8 * 10**9) & (wheels.stamps_ns < 10 * 10**9)
    v[slipping, 0] *= 1.3
    back_end = through(tmp_path, rng, count, replace(wheels, v_body=v))
    assert 3 <= back_end.account().wheels.slips <= 8
    assert [event.code for event in back_end.wheels.events()] == ["wheel-slip"]
    length = SPEED * 1e-9 * STEP_NS * (count - 1)
    assert back_end.T_map_imu[-1][0, 3] == pytest.approx(length, abs=0.01 * length)


@pytest.mark.parametrize(("factor", "ratio"), [(-1.0, "-1.00"), (3.6, "0.28")])
def test_wheels_with_a_wrong_sign_or_unit_are_told(tmp_path, rng, factor, ratio):
    back_end = through(tmp_path, rng, 30, speeds(rng, 30, factor), drift=0.0)
    (event,) = back_end.wheels.events()
    assert event.code == "wheel-contradiction"
    assert ratio in event.message
    assert not back_end.moves


def test_wheels_of_another_clock_are_told(tmp_path, rng):
    wheels = speeds(rng, 5, 1.0)
    late = replace(wheels, stamps_ns=wheels.stamps_ns + 3600 * 10**9)
    (event,) = through(tmp_path, rng, 5, late).wheels.events()
    assert event.code == "wheel-clock"
    assert "clock_offset" in event.message


def test_without_wheels_nothing_is_said(tmp_path, rng):
    back_end = through(tmp_path, rng, 5, None)
    assert back_end.account().wheels is None
    assert back_end.wheels.events() == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1.0,2.0\n2.0,2.0\n", "no header"),
        ("stamp,vx\n1.0,fast\n", "line 2: vx is 'fast'"),
        ("stamp,vx\n2.0,1.0\n1.0,1.0\n", "line 3: its stamp is not later"),
        ("stamp,vx\n1,0,2,0\n", "decimal commas"),
        ("stamp,vx\n1.0,3600\n", "metres a second"),
        ("time,rpm\n1.0,3\n", "no column vx"),
    ],
)
def test_wheel_files_that_cannot_be_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "wheels.csv"
    path.write_text(text)
    with pytest.raises(FormatError, match=message) as caught:
        read_wheel_speeds(path)
    assert "\n" not in str(caught.value)


def test_the_first_scan_is_the_map_and_leaves_no_step_open(rng):
    first, second, third = keyframes(rng, 3)
    first = replace(first, lidar_information=np.zeros((6, 6)))
    assert np.sqrt(np.diag(seen_covariance(first, second))).max() < 0.01
    broken = replace(second, lidar_information=np.zeros((6, 6)))  # a later one that nothing was matched with
    assert np.sqrt(np.diag(seen_covariance(broken, third))).max() > 10.0
