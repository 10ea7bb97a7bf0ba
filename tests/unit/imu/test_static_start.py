"""What rest tells, and when it is not rest."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.imu import assess_stillness
from states import GRAVITY, START_NS, random_rotation

CONFIG = ImuConfig()
RATE = 200.0


def resting(rng, *, duration=1.0, gyro_noise=5e-4, accel_noise=5e-3, gyro_bias=None, up=None):
    """Samples at rest with the densities given."""
    n = int(duration * RATE) + 1
    stamps = START_NS + np.arange(n, dtype=np.int64) * int(1e9 / RATE)
    gyro = gyro_noise * np.sqrt(RATE) * rng.normal(size=(n, 3)) + (np.zeros(3) if gyro_bias is None else gyro_bias)
    force = GRAVITY * (np.array([0.0, 0.0, 1.0]) if up is None else up)
    accel = accel_noise * np.sqrt(RATE) * rng.normal(size=(n, 3)) + force
    return ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=int(stamps[-1]))


@pytest.mark.parametrize("seed", range(5))
def test_rest_recovers_gravity_bias_and_noise(seed):
    rng = np.random.default_rng(seed)
    bias, up = rng.normal(scale=0.02, size=3), random_rotation(rng)[:, 2]
    rest = assess_stillness(resting(rng, duration=3.0, gyro_bias=bias, up=up), CONFIG)
    assert rest.still
    assert rest.reason == ""
    np.testing.assert_allclose(rest.gyro_mean, bias, atol=4 * 5e-4 / np.sqrt(3.0))
    np.testing.assert_allclose(rest.accel_mean, GRAVITY * up, atol=4 * 5e-3 / np.sqrt(3.0))
    assert rest.noise.gyro == pytest.approx(5e-4, rel=0.1)
    assert rest.noise.accel == pytest.approx(5e-3, rel=0.1)
    assert rest.period == pytest.approx(1 / RATE)
    assert rest.duration == pytest.approx(3.0)


def test_noise_stays_within_what_rest_may_tell(rng):
    silent = assess_stillness(resting(rng, gyro_noise=0.0, accel_noise=0.0), CONFIG).noise
    assert (silent.gyro, silent.accel) == (CONFIG.gyro_noise_floor, CONFIG.accel_noise_floor)
    loud = replace(CONFIG, still_gyro_sigma=9.0, still_accel_sigma=9.0)
    noisy = assess_stillness(resting(rng, gyro_noise=0.01, accel_noise=0.1), loud).noise
    assert (noisy.gyro, noisy.accel) == (CONFIG.gyro_noise, CONFIG.accel_noise)


def shaken(imu):
    t = (imu.stamps_ns - imu.stamps_ns[0])[:, None] * 1e-9
    return replace(imu, accel=imu.accel + np.sin(2 * np.pi * 3.0 * t))


def spinning(imu):
    return replace(imu, gyro=imu.gyro + np.array([0.0, 0.0, 0.5]))


def wobbling(imu):
    t = (imu.stamps_ns - imu.stamps_ns[0])[:, None] * 1e-9
    return replace(imu, gyro=imu.gyro + 0.1 * np.sin(2 * np.pi * 2.0 * t))


def falling(imu):
    return replace(imu, accel=0.8 * imu.accel)


def braking(imu):
    accel = imu.accel.copy()
    accel[len(accel) // 2 :, 0] += 0.45
    return replace(imu, accel=accel)


def short(imu):
    return replace(imu, stamps_ns=imu.stamps_ns[:60], gyro=imu.gyro[:60], accel=imu.accel[:60])


@pytest.mark.parametrize(
    ("disturb", "reason"),
    [
        (shaken, "accelerometer spread"),
        (spinning, "mean rate 0.5"),
        (wobbling, "gyro spread"),
        (falling, "gravity error 1.96"),
        (braking, "force change 0.4"),
        (short, "only 0.30"),
    ],
)
def test_motion_is_not_rest_and_the_reason_names_it(rng, disturb, reason):
    quiet = resting(rng, gyro_noise=1e-4, accel_noise=1e-3)
    assert assess_stillness(quiet, CONFIG).still
    verdict = assess_stillness(disturb(quiet), CONFIG)
    assert not verdict.still
    assert reason in verdict.reason
    assert verdict.noise.gyro == CONFIG.gyro_noise  # what moved tells nothing of noise


def test_gap_in_the_stamps_costs_nothing(rng):
    imu = resting(rng)
    stamps = imu.stamps_ns.copy()
    stamps[len(stamps) // 2 :] += 1_000_000_000 * 10**9  # 32 years: 1e10 half blocks, an array beyond the memory
    assert assess_stillness(replace(imu, stamps_ns=stamps), ImuConfig()).duration > 1e9


def test_two_samples_are_needed(rng):
    one = resting(rng, duration=0.0)
    assert len(one) == 1
    with pytest.raises(DataError, match="1 IMU samples"):
        assess_stillness(one, CONFIG)


def idling(rng, *, hertz, force, rate, duration=1.0):
    """At rest on an engine: a sinusoid with its second harmonic on every channel, in each its own phase."""
    imu = resting(rng, duration=duration, gyro_noise=1e-4, accel_noise=1e-3)
    t = (imu.stamps_ns - imu.stamps_ns[0])[:, None] * 1e-9
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 6))
    wave = np.sin(2.0 * np.pi * hertz * t + phase[0]) + 0.5 * np.sin(4.0 * np.pi * hertz * t + phase[1])
    return replace(imu, gyro=imu.gyro + rate * wave[:, :3], accel=imu.accel + force * wave[:, 3:])


@pytest.mark.parametrize("hertz", [15.0, 27.0, 41.0])
@pytest.mark.parametrize(("force", "rate"), [(1.0, 0.02), (3.0, 0.1), (0.1, 0.1)])
def test_an_idling_engine_is_rest_that_vibrates(rng, hertz, force, rate):
    rest = assess_stillness(idling(rng, hertz=hertz, force=force, rate=rate), CONFIG)
    assert rest.still
    assert rest.vibrating
    assert rest.grade == "fair"
    assert "vibrating" in rest.remark
    error = np.linalg.norm(rest.accel_mean - [0.0, 0.0, GRAVITY])
    assert error < 5.0 * np.sqrt(np.trace(rest.covariance[3:, 3:])) + 2e-3
    assert np.linalg.norm(rest.gyro_mean) < 5.0 * np.sqrt(np.trace(rest.covariance[:3, :3])) + 1e-4


@pytest.mark.parametrize(
    ("hertz", "force", "rate"), [(1.8, 1.0, 0.1), (3.0, 2.0, 0.3), (27.0, 12.0, 0.1), (5.0, 1.0, 0)]
)
def test_walking_and_rattling_are_not_rest(rng, hertz, force, rate):
    verdict = assess_stillness(idling(rng, hertz=hertz, force=force, rate=rate), CONFIG)
    assert not verdict.still
    assert not verdict.vibrating
    assert verdict.grade == "poor"
    assert verdict.statistic > 1.0


def test_a_turn_on_an_idling_engine_is_rest_only_by_consent_or_not_at_all(rng):
    imu = idling(rng, hertz=27.0, force=1.0, rate=0.05)
    slow, quick = (replace(imu, gyro=imu.gyro + np.array([0.0, 0.0, rate])) for rate in (0.15, 0.5))
    assert assess_stillness(slow, CONFIG).doubtful
    verdict = assess_stillness(quick, CONFIG)
    assert not verdict.still
    assert "mean rate" in verdict.reason


@pytest.mark.parametrize(
    ("gyro", "accel", "biased"),
    [
        ([0.09, 0.0, 0.0], [0.0, 0.0, 0.5], False),
        ([0.08, 0.08, -0.06], [0.0, 0.0, 0.1], True),
        ([0.0, 0.0, 0.0], [0.1, -0.2, -0.9], True),
    ],
)
def test_a_very_large_bias_is_rest_only_by_consent(rng, gyro, accel, biased):
    imu = resting(rng)
    rest = assess_stillness(replace(imu, gyro=imu.gyro + gyro, accel=imu.accel + accel), CONFIG)
    assert rest.still
    assert rest.doubtful is rest.biased is biased
    assert ("very large bias" in rest.remark) is biased
    assert rest.grade == "fair"  # for the other one is near the border of rest
    assert rest.statistic < 1.0


def test_covariance_of_the_means_fits_their_errors():
    """White noise: mean squared distance of the means from the truth is their number."""
    squares = []
    for seed in range(60):
        rest = assess_stillness(resting(np.random.default_rng(seed)), CONFIG)
        error = np.concatenate([rest.gyro_mean, rest.accel_mean - [0.0, 0.0, GRAVITY]])
        squares.append(error @ np.linalg.solve(rest.covariance, error))
        assert rest.grade == "good"
        assert rest.statistic < 0.8
    assert np.mean(squares) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 60.0))


def test_a_short_or_doubtful_rest_is_graded_fair(rng):
    brief = assess_stillness(resting(rng, duration=0.6), CONFIG)
    assert (brief.still, brief.grade) == (True, "fair")
    assert "short" in brief.remark
    heavy = replace(CONFIG, gravity=GRAVITY + 0.9 * CONFIG.still_gravity_error)
    doubtful = assess_stillness(resting(rng), heavy)
    assert (doubtful.still, doubtful.grade) == (True, "fair")
    assert "border" in doubtful.remark
