"""The noise of one IMU channel as a sum of known shapes: their spectra and their Allan deviations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from heliograph.arrays import Array

__all__ = ["RAMP", "TERMS", "allan_variance", "spectrum", "term_spectra"]


TERMS = ("quantisation", "white", "flicker", "walk")
"""IEEE 952's Q, N, B and K, by rising weight of the slow part."""
RAMP = "ramp"
"""A steady drift (R), such as from warming up; it is no noise, but it must not pass for one."""

FLICKER_FLOOR = float(np.sqrt(2.0 * np.log(2.0) / np.pi))
"""The Allan deviation of flicker noise over its bias instability: 0.664."""


def term_spectra(frequency: Array, period: float) -> Array:
    """Return the two-sided spectral density of each of `TERMS` with a coefficient of one, as sampled.

    Parameters
    ----------
    frequency : (b,) float64
        Above 0 and up to half the rate [Hz].
    period : float
        Between samples [s].

    Returns
    -------
    (4, b) float64
        Times the squared coefficient [unit^2/Hz].

    Notes
    -----
    Eq. (2) of docs/theory/noise.md: IEEE 952 annex C with ``2 pi f`` replaced by ``2 sin(pi f T) / T``, which is exact
    for sums and differences of samples.
    """
    omega = 2.0 * np.sin(np.pi * frequency * period) / period
    return np.stack([period * omega**2, np.ones_like(omega), 1.0 / omega, omega**-2])


def spectrum(squares: Mapping[str, float], frequency: Array, period: float) -> Array:
    """Return the spectral density of a sum of terms, given their squared coefficients [unit^2/Hz]."""
    shapes = term_spectra(frequency, period)
    return np.asarray(sum(squares.get(name, 0.0) * shape for name, shape in zip(TERMS, shapes, strict=True)))


def allan_variance(squares: Mapping[str, float], tau: Array, period: float) -> dict[str, Array]:
    """Return the Allan variance of each term, by name, at the averaging times.

    Parameters
    ----------
    squares : mapping of str to float
        Squared coefficients; what is left out is zero. `RAMP` may be among them.
    tau : (t,) float64
        Averaging times [s].
    period : float
        Between samples [s]; the random walk's variance depends a little on it.

    Notes
    -----
    Eq. (3) of docs/theory/noise.md; IEEE 952-1997 annex C. The random walk is the exact one of a walk in steps at the
    samples.
    """
    m = tau / period
    shapes = {
        "quantisation": 3.0 / tau**2,
        "white": 1.0 / tau,
        "flicker": np.full_like(tau, FLICKER_FLOOR**2),
        "walk": tau * (1.0 / 3.0 + 1.0 / (6.0 * m**2)),
        RAMP: 0.5 * tau**2,
    }
    return {name: squares.get(name, 0.0) * shape for name, shape in shapes.items()}
