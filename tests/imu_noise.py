"""Inertial noise of known coefficients, drawn sample by sample, and records at rest made of it."""

import numpy as np

from heliograph.data import ImuBatch
from heliograph.imu.stretches import Grid, ImuStretch

GRAVITY = 9.80665
START_NS = 1_700_000_000_000_000_000


def flicker(rng, n, coefficient):
    """Noise whose density is B^2 / 2 pi f: white noise summed half a time (Kasdin, Proc. IEEE 83, 1995)."""
    length = 2 * n  # the first half lets the sum forget that it began
    k = np.arange(1, length)
    weights = np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])
    size = 2 * length
    spectrum = np.fft.rfft(weights, size) * np.fft.rfft(coefficient * rng.normal(size=length), size)
    return np.fft.irfft(spectrum, size)[n:length]


def draw(rng, n, period, *, white=0.0, flicker_b=0.0, walk=0.0, quantisation=0.0, ramp=0.0):
    """Return n samples with the coefficients N, B, K, Q and R given."""
    signal = white / np.sqrt(period) * rng.normal(size=n) + ramp * period * np.arange(n)
    if flicker_b:
        signal = signal + flicker(rng, n, flicker_b)
    if walk:
        signal = signal + walk * np.sqrt(period) * np.cumsum(rng.normal(size=n))
    if quantisation:
        signal = signal + quantisation / period * np.diff(rng.normal(size=n + 1))
    return signal


def grid_of(columns, period):
    return Grid(
        period=period, stretches=(ImuStretch(begin_ns=START_NS, samples=np.stack(columns, axis=1)),), filled=0, gaps=0
    )


def resting_imu(rng, *, duration, rate, gyro=None, accel=None, bias=0.01):
    """A record at rest, z up, with constant biases; ``gyro`` and ``accel`` are coefficients for `draw`."""
    n = round(duration * rate)
    gyro, accel = gyro or {"white": 2e-4}, accel or {"white": 2e-3}
    rates = np.stack([draw(rng, n, 1.0 / rate, **gyro) for _ in range(3)], axis=1) + bias * rng.normal(size=3)
    force = np.stack([draw(rng, n, 1.0 / rate, **accel) for _ in range(3)], axis=1) + np.array([0.0, 0.0, GRAVITY])
    stamps = START_NS + np.rint(np.arange(n) * (1e9 / rate)).astype(np.int64)
    return ImuBatch(stamps_ns=stamps, gyro=rates, accel=force, received_ns=int(stamps[-1]))
