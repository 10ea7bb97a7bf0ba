"""The noise of whole recordings: which evidence is used, what comes out for a filter, what is said."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heliograph.calibration import calibrate_noise
from heliograph.cli.calibrate_noise import noise_facts, noise_lines
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.report.noise import noise_charts
from imu_noise import START_NS, resting_imu

CONFIG = ImuConfig()
RATE = 100.0
GYRO = {"white": 2e-4, "walk": 1e-4}
ACCEL = {"white": 2e-3, "walk": 1e-3}


def seconds(imu):
    return 1e-9 * (imu.stamps_ns - START_NS)[:, None]


def moving(imu):
    t = seconds(imu)
    return replace(imu, gyro=imu.gyro + 0.3 * np.sin(2.0 * t), accel=imu.accel + np.sin(3.0 * t))


def codes(result):
    return [event.code for event in result.events]


@pytest.fixture(scope="module")
def resting():
    return resting_imu(np.random.default_rng(5), duration=300.0, rate=RATE, gyro=GYRO, accel=ACCEL)


def test_rest_gives_densities_and_walks_for_a_filter(resting):
    result = calibrate_noise(resting, CONFIG)
    assert (result.evidence, result.motion, codes(result)) == ("rest", None, [])
    for found, truth in ((result.gyro, GYRO), (result.accel, ACCEL)):
        assert found.white == pytest.approx(truth["white"], abs=4.0 * found.white_sigma)
        assert found.walk == pytest.approx(truth["walk"], abs=4.0 * found.walk_sigma)
        assert found.white_sigma < 0.01 * found.white and found.walk_sigma < 0.25 * found.walk
    axes = [channel.term("white") for channel in result.rest.channels[:3]]
    assert result.gyro.white == pytest.approx(np.sqrt(np.mean([axis.value**2 for axis in axes])))
    assert result.gyro.white_sigma == pytest.approx(np.mean([axis.sigma for axis in axes]) / np.sqrt(3.0), rel=0.05)
    assert (result.noise.gyro, result.noise.accel_walk) == (result.gyro.white, result.accel.walk)
    assert (result.rate, result.duration) == (pytest.approx(RATE), pytest.approx(300.0))
    assert result.rest.floor.shape == result.rest.floor_tau.shape == (6,)


def test_the_still_part_of_a_drive_is_found_and_vibration_is_counted(resting):
    rng = np.random.default_rng(6)
    shaken = moving(resting)
    shaken = replace(shaken, accel=shaken.accel + 0.3 * rng.normal(size=shaken.accel.shape))
    late = (seconds(resting) > 200.0)[:, 0]
    mixed = replace(
        resting,
        gyro=np.where(late[:, None], shaken.gyro, resting.gyro),
        accel=np.where(late[:, None], shaken.accel, resting.accel),
    )
    result = calibrate_noise(mixed, CONFIG)
    assert result.evidence == "rest"
    [(begin, length)] = result.rest.stretches
    assert begin == START_NS and 195.0 < length <= 200.0
    assert result.gyro.white == pytest.approx(2e-4, rel=0.02)
    assert result.accel.white == pytest.approx(2e-3, rel=0.02)
    assert result.accel.for_filter == result.accel.with_vibration > 5.0 * result.accel.white
    assert codes(result) == ["noise-vibration"]
    # The gyroscope feels nothing of it: its two readings agree.
    assert result.gyro.with_vibration == pytest.approx(2e-4, rel=0.1)


def test_recording_without_rest_gives_white_noise_and_owns_up_to_the_rest(resting):
    result = calibrate_noise(moving(resting), CONFIG)
    assert (result.evidence, result.rest, codes(result)) == ("motion", None, ["noise-moving"])
    assert result.gyro.white == pytest.approx(2e-4, abs=4.0 * result.gyro.white_sigma)
    assert result.gyro.walk is None and result.gyro.walk_upper == float("inf")
    assert (result.noise.gyro_walk, result.noise.accel_walk) == (CONFIG.gyro_walk, CONFIG.accel_walk)


def test_spectrum_without_a_floor_falls_back_to_the_configured_density(rng):
    imu = resting_imu(rng, duration=300.0, rate=RATE)
    shake = np.cumsum(rng.normal(size=imu.gyro.shape), axis=0)
    result = calibrate_noise(replace(imu, gyro=imu.gyro + shake), CONFIG)
    assert result.gyro.white is None and result.noise.gyro == CONFIG.gyro_noise
    assert np.isfinite(result.gyro.white_upper)
    assert "noise-no-floor" in codes(result)


def test_dead_channel_hum_and_losses_are_told(rng):
    imu = resting_imu(rng, duration=120.0, rate=RATE)
    gyro, accel = imu.gyro.copy(), imu.accel.copy()
    gyro[:, 1] = 0.01
    accel[:, 0] += 0.02 * np.sin(2.0 * np.pi * 31.0 * seconds(imu)[:, 0])
    keep = rng.uniform(size=len(imu)) > 0.1
    result = calibrate_noise(replace(imu, stamps_ns=imu.stamps_ns[keep], gyro=gyro[keep], accel=accel[keep]), CONFIG)
    assert {"noise-constant", "noise-lines", "noise-losses"} <= set(codes(result))
    messages = {event.code: event.message for event in result.events}
    assert "gyro y" in messages["noise-constant"] and "31" in messages["noise-lines"]
    assert result.rest.channels[1].model == {}
    assert result.gyro.white == pytest.approx(2e-4, rel=0.2)  # of the two other axes


@pytest.mark.parametrize(("hertz", "code"), [(8.0, "noise-bend"), (0.3, "noise-misfit")])
def test_vibration_in_the_rest_is_told(rng, hertz, code):
    """At the top of the spectrum it is cut away, at its bottom it cannot be."""
    imu = resting_imu(rng, duration=600.0, rate=RATE)
    t = seconds(imu)[:, 0]
    phase = np.sqrt(0.5 * hertz) * np.cumsum(rng.normal(size=len(t))) / np.sqrt(RATE)
    accel = imu.accel.copy()
    accel[:, 1] += 0.02 * np.sin(2.0 * np.pi * hertz * t + phase)
    result = calibrate_noise(replace(imu, accel=accel), CONFIG)
    assert "accel y" in {event.code: event.message for event in result.events}[code]


def test_gap_in_the_rest_costs_little(resting):
    keep = np.ones(len(resting), dtype=bool)
    keep[20_000:25_000] = False
    cut = replace(resting, stamps_ns=resting.stamps_ns[keep], gyro=resting.gyro[keep], accel=resting.accel[keep])
    result = calibrate_noise(cut, CONFIG)
    assert len(result.rest.stretches) == 2
    assert result.gyro.white == pytest.approx(2e-4, rel=0.01)
    assert result.gyro.walk == pytest.approx(1e-4, abs=4.0 * result.gyro.walk_sigma)


@pytest.mark.parametrize("n", [0, 1, 2, 20])
def test_too_few_samples_are_refused_in_one_line(rng, n):
    imu = resting_imu(rng, duration=1.0, rate=RATE)
    few = replace(imu, stamps_ns=imu.stamps_ns[:n], gyro=imu.gyro[:n], accel=imu.accel[:n])
    with pytest.raises(DataError, match=f"^{n} IMU samples.*(record|check)") as caught:
        calibrate_noise(few, CONFIG)
    assert "\n" not in str(caught.value)


SIGNALS = {
    "constant": lambda n, _: np.tile([0.01, -0.02, 0.0], (n, 1)),
    "noise": lambda n, rng: rng.normal(size=(n, 3)),
    "tiny": lambda n, rng: 1e-12 * rng.normal(size=(n, 3)),
    "walk": lambda n, rng: np.cumsum(rng.normal(size=(n, 3)), axis=0),
    "coarse": lambda n, rng: np.round(rng.normal(size=(n, 3))),
    "one spike": lambda n, _: np.eye(n, 3),
    "ramp": lambda n, _: np.linspace(0.0, 1.0, n)[:, None] * [1.0, 2.0, 3.0],
    "square": lambda n, _: (np.arange(n)[:, None] // 7 % 2) * np.ones(3),
}


@settings(max_examples=10, deadline=None)
@given(
    gyro=st.sampled_from(sorted(SIGNALS)),
    accel=st.sampled_from(sorted(SIGNALS)),
    n=st.integers(0, 1500),
    period_ns=st.sampled_from([1_000_000, 5_000_000, 10_000_000, 100_000_000]),
    scale=st.floats(1e-6, 10.0),
    loss=st.sampled_from([0.0, 0.01, 0.3]),
    seed=st.integers(0, 2**31),
)
@example(gyro="coarse", accel="constant", n=615, period_ns=10_000_000, scale=0.0234375, loss=0.0, seed=0)
def test_any_signal_gives_finite_numbers_or_one_line(gyro, accel, n, period_ns, scale, loss, seed):
    rng = np.random.default_rng(seed)
    keep = rng.uniform(size=n) >= loss
    imu = ImuBatch(
        stamps_ns=(START_NS + period_ns * np.arange(n))[keep],
        gyro=scale * SIGNALS[gyro](n, rng)[keep],
        accel=scale * SIGNALS[accel](n, rng)[keep] + [0.0, 0.0, 9.80665],
        received_ns=0,
    )
    try:
        result = calibrate_noise(imu, CONFIG)
    except DataError as error:
        refused = str(error)
    else:
        refused = ""
    assert "\n" not in refused
    if refused:
        assert len(imu) < 40 or loss > 0.0
        return
    for found in (result.gyro, result.accel):
        assert all(v is None or (np.isfinite(v) and v >= 0.0) for v in (found.white, found.walk, found.white_sigma))
        assert not np.isnan(found.walk_upper) and not np.isnan(found.white_upper)
    json.dumps(noise_facts(result, "any"), allow_nan=False)
    assert all(noise_lines(result))
    for chart in noise_charts(result).values():
        assert "nan" not in chart


def test_nan_and_reversed_stamps_are_refused(resting):
    gyro = resting.gyro.copy()
    gyro[7, 1] = np.nan
    with pytest.raises(DataError, match="not finite"):
        replace(resting, gyro=gyro)
    with pytest.raises(DataError, match="do not increase; sort"):
        calibrate_noise(replace(resting, stamps_ns=resting.stamps_ns[::-1]), CONFIG)
