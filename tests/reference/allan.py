"""The overlapping Allan deviation as its definition reads: pairs of neighbouring averages, no running sums."""

import numpy as np


def allan_deviation_slowly(signal, m, every=1):
    averages = np.array([signal[i : i + m].mean() for i in range(len(signal) - m + 1)])
    differences = (averages[m:] - averages[:-m])[::every]
    return np.sqrt(0.5 * np.mean(differences**2))


def cosine_coefficients_slowly(signal):
    """The orthonormal DCT-II without its first coefficient, term by term."""
    n = len(signal)
    k, i = np.arange(1, n)[:, None], np.arange(n)
    return np.sqrt(2.0 / n) * (np.cos(np.pi * k * (2 * i + 1) / (2 * n)) @ signal)
