"""The overlapping Allan deviation of an IMU at rest, with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.errors import DataError
from heliograph.imu.stretches import Grid

__all__ = ["AllanCurve", "allan_curve", "degrees_of_freedom"]


_TIMES_PER_OCTAVE = 4  # averaging times
_MAX_OVERLAP = 8  # differences taken within one averaging time; more of them tell nothing new
_ONE_SIGMA_SHARE = 0.6827  # probability inside one sigma


@dataclass(frozen=True, slots=True, kw_only=True)
class AllanCurve:
    """Allan deviations of the six channels over the averaging time.

    Parameters
    ----------
    tau : (t,) float64
        Averaging times [s].
    deviation : (t, 6) float64
        Gyroscope [rad/s], then accelerometer [m/s^2].
    terms : (t,) int64
        Overlapping differences that went into each.
    lengths : (s,) int64
        Samples of each stretch.
    period : float
        Between samples [s].
    """

    tau: Array
    deviation: Array
    terms: NDArray[np.int64]
    lengths: NDArray[np.int64]
    period: float

    def __post_init__(self) -> None:
        freeze(self)

    def interval(self, noise: Sequence[str], channel: int, probability: float = _ONE_SIGMA_SHARE) -> Array:
        """Return the interval that holds the true deviation of a channel, (t, 2) [rad/s] or [m/s^2].

        Parameters
        ----------
        noise : sequence of str
            The term of `heliograph.imu.noise_terms.TERMS` (or ``"ramp"``) that dominates at each averaging time.
        channel : int
            0 to 5.
        probability : float
            Probability that the interval holds the truth.

        Notes
        -----
        ``dof * estimate / truth`` is taken to be chi-square (Riley, NIST SP 1065, section 5.3.2).
        """
        tail = 0.5 * (1.0 - probability)
        bounds = np.empty((len(self.tau), 2))
        for k, tau in enumerate(self.tau):
            m = round(tau / self.period)
            dof = sum(degrees_of_freedom(noise[k], int(n) + 1, m) for n in self.lengths if n >= 2 * m)
            if noise[k] == "quantisation":  # its differences hardly overlap, so leaving some out costs
                dof = max(min(dof, 0.5 * float(self.terms[k])), 1.0)
            low, high = (np.sqrt(dof / chi_square_quantile(p, dof)) for p in (1.0 - tail, tail))
            bounds[k] = self.deviation[k, channel] * low, self.deviation[k, channel] * high
        return bounds


def allan_curve(grid: Grid) -> AllanCurve:
    """Return the overlapping Allan deviation of all channels, from one averaged sample to a third of the record.

    Parameters
    ----------
    grid : Grid
        At rest throughout; see `heliograph.imu.stretches.still_stretches`.

    Raises
    ------
    DataError
        No stretch has the three samples that one difference of averages needs.

    Notes
    -----
    Eq. (4) of docs/theory/noise.md (Riley, NIST SP 1065, eq. 11): with θ the running sum of the signal, the mean of
    ``(θ[i+2m] - 2 θ[i+m] + θ[i])^2`` over ``2 m^2``. Above eight samples not every offset i is used: differences
    an eighth of the averaging time apart already hold all there is, so the time taken does not grow with the number
    of averaging times. Stretches are pooled by their numbers of differences.
    """
    longest = max((len(stretch) for stretch in grid.stretches), default=0)
    if longest < 3:
        raise DataError(f"{longest} samples in a row at rest; an Allan deviation needs at least 3")
    octaves = np.arange(0.0, np.log2(longest / 3.0) + 1e-9, 1.0 / _TIMES_PER_OCTAVE)
    sizes = np.unique(np.rint(2.0**octaves).astype(np.int64))
    total, terms = np.zeros((len(sizes), 6)), np.zeros(len(sizes), np.int64)
    for stretch in grid.stretches:
        for channel in range(6):
            total[:, channel] += _summed_squares(stretch.samples[:, channel], sizes)
        terms += np.maximum((len(stretch) - 2 * sizes) // _strides(sizes) + 1, 0)
    used = terms > 0
    return AllanCurve(
        tau=np.asarray(grid.period * sizes[used], dtype=np.float64),
        deviation=np.sqrt(total[used] / terms[used, None]),
        terms=terms[used],
        lengths=np.array([len(stretch) for stretch in grid.stretches], dtype=np.int64),
        period=grid.period,
    )


def _strides(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.maximum(sizes // _MAX_OVERLAP, 1)


def _summed_squares(signal: Array, sizes: NDArray[np.int64]) -> Array:
    """Return the sum in eq. (4) over ``2 m^2`` for each size, 0 where the signal is too short."""
    # The mean is taken off first: the sum of hours of 9.8 m/s^2 would leave few digits for the noise.
    angle = np.concatenate([np.zeros(1), np.cumsum(signal - signal.mean())])
    total = np.zeros(len(sizes))
    for k, (m, every) in enumerate(zip(sizes.tolist(), _strides(sizes).tolist(), strict=True)):
        if len(signal) >= 2 * m:
            middle = angle[m : len(angle) - m : every]
            difference = angle[2 * m :: every] + angle[: len(angle) - 2 * m : every]
            difference -= 2.0 * middle
            total[k] = float(difference @ difference) / (2.0 * m**2)
    return total


def degrees_of_freedom(noise: str, phases: int, m: int) -> float:
    """Return the equivalent degrees of freedom of one overlapping Allan variance.

    Parameters
    ----------
    noise : str
        The dominating term: ``"quantisation"``, ``"white"``, ``"flicker"``, ``"walk"`` or ``"ramp"``.
    phases : int
        Points of the running sum: one more than samples.
    m : int
        Samples averaged.

    Returns
    -------
    float
        At least 1.

    Notes
    -----
    D. Howe, D. Allan, J. Barnes, "Properties of signal sources and measurement methods", 1981, as given by W. Riley,
    "Handbook of Frequency Stability Analysis", NIST SP 1065, 2008, table 5. What is white in a rate is white frequency
    noise there; quantisation is white phase noise. A ramp has no degrees of freedom: the random walk's stand in.
    """
    n = float(phases)
    if noise == "quantisation":
        dof = (n + 1.0) * (n - 2.0 * m) / (2.0 * (n - m))
    elif noise == "white":
        dof = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    elif noise == "flicker" and m == 1:
        dof = 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9)
    elif noise == "flicker":
        dof = 5.0 * n**2 / (4.0 * m * (n + 3.0 * m))
    else:
        dof = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    return max(dof, 1.0)
