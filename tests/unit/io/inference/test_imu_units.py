"""Units of an IMU from the physics of its samples."""

import numpy as np
import pytest

from heliograph.config import InputConfig
from heliograph.io.inference.imu_units import GRAVITY, infer_imu_units
from heliograph.io.raw import RawImu


def samples(gyro, accel, rate=200):
    return [
        RawImu(topic="/imu", received_ns=k, stamp_ns=k * 10**9 // rate, frame_id="imu", gyro=tuple(w), accel=tuple(a))
        for k, (w, a) in enumerate(zip(gyro, accel, strict=True))
    ]


def rocking(rng, n=400, rate=200):
    """Rates about x [rad/s] and what an accelerometer reads: gravity turned by their integral, with noise."""
    t = np.arange(n) / rate
    angle = 0.3 * np.sin(2 * np.pi * 0.8 * t)
    gyro = np.zeros((n, 3))
    gyro[:, 0] = 0.3 * 2 * np.pi * 0.8 * np.cos(2 * np.pi * 0.8 * t)
    accel = GRAVITY * np.stack([np.zeros(n), np.sin(angle), np.cos(angle)], axis=1)
    return gyro + 0.005 * rng.normal(size=(n, 3)), accel + 0.3 * rng.normal(size=(n, 3))


def resting(rng, bias, n=400):
    return bias + 0.002 * rng.normal(size=(n, 3)), np.array([0.0, 0.0, GRAVITY]) + 0.02 * rng.normal(size=(n, 3))


def value(units, name):
    return next(i for i in units.inferences if i.name == name)


@pytest.mark.parametrize(("scale", "unit", "factor"), [(1.0, "m/s^2", 1.0), (1 / GRAVITY, "g", GRAVITY)])
def test_accelerometer_unit_is_told_by_gravity(rng, scale, unit, factor):
    gyro, accel = rocking(rng)
    units = infer_imu_units(samples(gyro, accel * scale), InputConfig())
    assert value(units, "accelerometer unit").value == unit
    assert units.accel == factor
    assert [e.code for e in units.events] == (["accel-in-g"] if unit == "g" else [])


@pytest.mark.parametrize(
    ("size", "factor", "code"),
    [
        (0.29, 1.0, "accel-unit"),
        (0.31, GRAVITY, "accel-in-g"),
        (2.9, GRAVITY, "accel-in-g"),
        (3.1, 1.0, None),
        (7.9, 1.0, None),
        (29.0, 1.0, None),
        (31.0, 1.0, "accel-unit"),
    ],
)
def test_accelerometer_counts_in_g_up_to_a_magnitude_of_3(size, factor, code):
    accel = np.tile([0.0, 0.0, size], (50, 1))
    units = infer_imu_units(samples(np.zeros((50, 3)), accel), InputConfig())
    assert units.accel == factor
    assert [e.code for e in units.events] == ([code] if code else [])


def test_accelerometer_in_no_known_unit_warns(rng):
    gyro, accel = rocking(rng)
    units = infer_imu_units(samples(gyro, accel * 1000), InputConfig())
    assert units.accel == 1.0
    assert [e.code for e in units.events] == ["accel-unit"]


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "rad/s"), (180 / np.pi, "deg/s")])
def test_gyroscope_unit_is_told_by_the_turn_of_gravity(rng, scale, unit):
    gyro, accel = rocking(rng)
    # 30 deg/s stays below the largest rate that a gyroscope can have in rad/s only if the swing is small enough.
    units = infer_imu_units(samples(0.4 * gyro * scale, _tilt(accel, 0.4)), InputConfig())
    found = value(units, "gyroscope unit")
    assert found.value == unit
    assert "direction of gravity" in found.evidence
    assert units.gyro == pytest.approx(1.0 if unit == "rad/s" else np.pi / 180)


def _tilt(accel, share):
    angle = share * np.arctan2(accel[:, 1], accel[:, 2])
    return GRAVITY * np.stack([np.zeros(len(accel)), np.sin(angle), np.cos(angle)], axis=1)


def test_rates_beyond_any_gyroscope_are_degrees(rng):
    gyro, accel = resting(rng, np.zeros(3))
    gyro[50] = (0.0, 0.0, 90.0)
    assert value(infer_imu_units(samples(gyro, accel), InputConfig()), "gyroscope unit").value == "deg/s"


@pytest.mark.parametrize(("bias", "unit"), [((0.02, -0.01, 0.01), "rad/s"), ((0.5, -0.3, 0.2), "deg/s")])
def test_gyroscope_unit_at_rest_is_told_by_its_bias(rng, bias, unit):
    gyro, accel = resting(rng, np.array(bias))
    found = value(infer_imu_units(samples(gyro, accel), InputConfig()), "gyroscope unit")
    assert found.value == unit
    assert "at rest" in found.evidence


def test_yawing_vehicle_keeps_the_ros_unit_and_says_so(rng):
    gyro, accel = resting(rng, np.array([0.0, 0.0, 0.8]))
    accel += 0.5 * rng.normal(size=accel.shape)
    found = value(infer_imu_units(samples(gyro, accel), InputConfig()), "gyroscope unit")
    assert (found.value, found.source) == ("rad/s", "default")


def test_a_steady_bend_on_wheels_is_not_a_bias_in_degrees(rng):
    """As calm as rest and pushed outwards: the rate is along the vertical and quieter than a gyroscope in deg/s."""
    gyro, accel = resting(rng, np.array([0.0, 0.0, 0.8]))
    gyro[:, 2] += np.linspace(-0.1, 0.1, len(gyro))
    accel[:, 1] += 1.2
    found = value(infer_imu_units(samples(gyro, accel), InputConfig()), "gyroscope unit")
    assert (found.value, found.source) == ("rad/s", "data")
    assert "bend" in found.evidence
    noisy = gyro + 0.1 * rng.normal(size=gyro.shape)
    assert value(infer_imu_units(samples(noisy, accel), InputConfig()), "gyroscope unit").value == "deg/s"


def test_overrides_are_obeyed(rng):
    gyro, accel = rocking(rng)
    units = infer_imu_units(samples(gyro, accel), InputConfig(accel_unit="g", gyro_unit="deg/s"))
    assert (units.accel, units.gyro) == (GRAVITY, np.pi / 180)
    assert {i.source for i in units.inferences} == {"override"}


def test_unusable_samples_do_not_decide(rng):
    gyro, accel = rocking(rng)
    accel[::7] = np.nan
    assert value(infer_imu_units(samples(gyro, accel), InputConfig()), "accelerometer unit").value == "m/s^2"
