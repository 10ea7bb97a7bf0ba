"""Clock, order, gaps, spacing and rate of an IMU's stamps, with stamps and times of reception made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.checks import ImuRecord, check_imu
from heliograph.config import CheckConfig
from imu_records import jumped, picked

START = 1_700_000_000_000_000_000


def record(seconds=20.0, rate=200.0, *, jitter=0.0, delay=None, seed=0):
    """An IMU in slow motion; ``delay`` gives the way to the recorder for each sample [s]."""
    rng = np.random.default_rng(seed)
    n = round(seconds * rate)
    at = np.arange(n) / rate
    gyro, accel = 0.1 * rng.standard_normal((n, 3)), [0.0, 0.0, 9.8] + 0.1 * rng.standard_normal((n, 3))
    stamps = START + np.round(1e9 * (at + jitter * rng.uniform(-1.0, 1.0, n))).astype(np.int64)
    late = np.zeros(n) if delay is None else delay(at, rng)
    received = START + np.round(1e9 * np.maximum.accumulate(at + late)).astype(np.int64)
    return ImuRecord(stamps_ns=stamps, received_ns=received, gyro=gyro, accel=accel)


def usual_delay(at, rng):
    return 0.002 + rng.exponential(0.001, len(at))


def found(imu, config=None):
    return {finding.code: finding for finding in check_imu(imu, config=config)}


STAMPS = ("imu-clock", "imu-order", "imu-gaps", "imu-rate", "imu-jitter")


@pytest.mark.parametrize("delay", [None, usual_delay])
@pytest.mark.parametrize("jitter", [0.0, 0.001])
def test_ordinary_transport_raises_no_alarm(delay, jitter):
    verdicts = found(record(jitter=jitter, delay=delay))
    assert [verdicts[code].verdict for code in STAMPS] == ["ok"] * 5


@pytest.mark.parametrize("at_s", [3.0, 10.0, 17.5])
@pytest.mark.parametrize("by_s", [0.2, -0.2, 0.05, 3600.0])
def test_step_of_the_clock_is_named_with_size_and_instant(by_s, at_s):
    imu = record(delay=usual_delay)
    step = found(jumped(at_s, by_s)(imu))["imu-clock"]
    assert step.verdict == "fail" and "jump once" in step.evidence
    assert step.numbers[0].value == pytest.approx(by_s, abs=0.012)
    assert step.stamps_ns[0] - round(1e9 * by_s) == pytest.approx(START + 1e9 * at_s, abs=2e7)


def test_step_forward_is_no_gap_and_step_back_runs_back():
    imu = record(delay=usual_delay)
    forward, back = found(jumped(10.0, 0.2)(imu)), found(jumped(10.0, -0.2)(imu))
    assert forward["imu-gaps"].verdict == "ok" and forward["imu-order"].verdict == "ok"
    assert back["imu-order"].numbers[0].value == pytest.approx(0.2 * 200 / 4000, abs=5e-4)


def test_two_steps_are_counted():
    imu = jumped(14.0, -0.5)(jumped(6.0, 0.5)(record()))
    assert "jump 2 times" in found(imu)["imu-clock"].evidence


def test_messages_held_up_in_a_queue_are_no_step():
    def stalled(at, rng):
        held = np.where((at > 5.0) & (at < 9.0), 9.0 - at, 0.0)  # four seconds come at once
        return held + usual_delay(at, rng)

    def for_good(at, rng):
        return np.where(at > 10.0, 0.1, 0.0) + usual_delay(at, rng)  # a slower way from then on

    assert found(record(delay=stalled))["imu-clock"].verdict == "ok"
    assert found(record(delay=for_good))["imu-clock"].verdict == "ok"


@pytest.mark.parametrize(("ppm", "verdict"), [(0.0, "ok"), (100.0, "ok"), (2000.0, "warn"), (-2000.0, "warn")])
def test_drift_of_the_clock_is_measured(ppm, verdict):
    imu = record(60.0, delay=usual_delay)
    stamps = START + np.round((imu.stamps_ns - START) * (1.0 + 1e-6 * ppm)).astype(np.int64)
    clock = found(replace(imu, stamps_ns=stamps))["imu-clock"]
    assert clock.verdict == verdict
    assert clock.numbers[0].value == pytest.approx(ppm, abs=30.0)


def test_repeated_messages_are_told_and_harmless():
    doubled = found(picked(record(), np.repeat(np.arange(4000), 2)))
    assert doubled["imu-order"].verdict == "warn" and "4000 samples repeat" in doubled["imu-order"].evidence
    assert doubled["imu-gaps"].verdict == doubled["imu-channels"].verdict == "ok"


def test_swapped_stamps_are_told():
    imu = record()
    stamps = imu.stamps_ns.copy()
    stamps[::20], stamps[1::20] = imu.stamps_ns[1::20], imu.stamps_ns[::20]
    order = found(replace(imu, stamps_ns=stamps))["imu-order"]
    assert order.verdict == "fail" and "200 run back" in order.evidence


@pytest.mark.parametrize(("rate", "verdict"), [(100.0, "ok"), (50.0, "warn"), (10.0, "warn"), (2.0, "fail")])
def test_rate_is_judged(rate, verdict):
    assert found(record(30.0, rate))["imu-rate"].verdict == verdict


def test_samples_that_come_in_pairs_are_told():
    imu = record()
    stamps = START + (np.arange(4000) // 2) * 10_000_000 + (np.arange(4000) % 2) * 100_000
    spacing = found(replace(imu, stamps_ns=stamps))["imu-jitter"]
    assert spacing.verdict == "warn" and spacing.numbers[0].value > 0.4


def test_samples_that_hold_no_numbers_are_told():
    imu = record()
    gyro = imu.gyro.copy()
    gyro[100:103] = np.nan
    values = found(replace(imu, gyro=gyro))["imu-values"]
    assert values.verdict == "warn" and "3 of 4000" in values.evidence
    assert found(replace(imu, gyro=np.full((4000, 3), np.nan)))["imu-values"].verdict == "fail"


def test_stamps_of_reception_are_told():
    clock = found(replace(record(), stamp="received"))["imu-clock"]
    assert clock.verdict == "warn" and "do not advance" in clock.evidence


PAUSED = picked(record(), np.r_[:1000, 1060:4000])  # without 0.3 s


@pytest.mark.parametrize(
    ("imu", "code", "usual", "config", "other"),
    [
        (record(rate=60.0), "imu-rate", "warn", CheckConfig(good_rate=50.0), "ok"),
        (record(rate=60.0), "imu-rate", "warn", CheckConfig(min_rate=70.0), "fail"),
        (record(jitter=0.001), "imu-jitter", "ok", CheckConfig(max_jitter=0.05), "warn"),
        (PAUSED, "imu-gaps", "warn", CheckConfig(max_gap=0.2), "fail"),
        (PAUSED, "imu-gaps", "warn", CheckConfig(max_missing=0.01), "fail"),
        (record(), "imu-vibration", "warn", CheckConfig(warn_vibration_gyro=1.0), "ok"),
        (record(), "imu-vibration", "warn", CheckConfig(warn_vibration_accel=0.001, max_vibration_accel=0.01), "fail"),
    ],
)
def test_limits_of_a_verdict_follow_the_configuration(imu, code, usual, config, other):
    assert found(imu)[code].verdict == usual
    assert found(imu, config)[code].verdict == other
