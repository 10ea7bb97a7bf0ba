"""White noise of an IMU in motion: what is left of its spectrum where the motion has no power."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.errors import DataError
from heliograph.imu.stretches import Grid, even_stretches

__all__ = ["WhiteFloor", "noise_in_motion", "white_floor"]


_WINDOW, _MIN_SAMPLES, _USUAL_SAMPLES = 1.0, 40, 128  # length of a spectrum [s], and samples in it
_TINY = 1e-100  # stands in for a level of zero
_BANDS = 16  # from zero to half the rate, equally wide
_CALM_RATIO = 2.0  # a window counts as calm up to this multiple of the quietest tenth's level
_BAND_TOLERANCE = 0.1  # bands that differ by less in power are taken as equally high
_FLAT_BANDS = 5  # bands in a row that must be equally high to show a floor
_MAX_SLOPE = 0.08  # by how much the logarithm of power may differ between the floor's lower and upper half
# Blackman and Harris's four terms: sidelobes 92 dB down, so that motion does not leak into the bands above it (F. J.
# Harris, "On the use of windows for harmonic analysis", Proc. IEEE 66, 1978).
_TAPER = (0.35875, -0.48829, 0.14128, -0.01168)


@dataclass(frozen=True, slots=True, kw_only=True)
class WhiteFloor:
    """The flat part of the six channels' spectra: gyroscope, then accelerometer.

    Parameters
    ----------
    density, sigma : (6,) float64
        White noise and its standard deviation [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    loud : (6,) float64
        The same band over the whole record: noise and the vibration that a filter meets as noise.
    band : (6, 2) float64
        Where each floor was read [Hz].
    flat : (6,) bool
        Whether the spectrum has a floor; if not, ``density`` is only an upper bound.
    calm : float
        Share of the record that the floors were read from: what was not shaken.
    frequency : (k,) float64
        Frequencies of ``spectrum`` [Hz].
    spectrum : (k, 6) float64
        Mean density over the calm windows, as ``density``.
    """

    density: Array
    sigma: Array
    loud: Array
    band: Array
    flat: NDArray[np.bool_]
    calm: float
    frequency: Array
    spectrum: Array

    def __post_init__(self) -> None:
        freeze(self)


def noise_in_motion(imu: ImuBatch, config: ImuConfig) -> ImuNoise:
    """Return densities for a filter that starts in motion: the configured ones, or more where the samples show more.

    Vibration counts as noise, because a filter cannot tell them apart. An IMU quieter than configured is not taken at
    its word: in motion scale errors and the errors of the start outweigh its white noise, and a filter that is given
    less than configured was found to track worse.

    Parameters
    ----------
    imu : ImuBatch
        A second or more of samples; with fewer, or where their spectrum has no floor, the configured densities stand.
    config : ImuConfig
    """
    gyro, accel = config.gyro_noise, config.accel_noise
    try:
        floor = white_floor(even_stretches(imu))
    except DataError:
        return ImuNoise(gyro=gyro, accel=accel, gyro_walk=config.gyro_walk, accel_walk=config.accel_walk)
    if floor.flat[:3].all():
        gyro = max(gyro, float(np.sqrt(np.mean(floor.loud[:3] ** 2))))
    if floor.flat[3:].all():
        accel = max(accel, float(np.sqrt(np.mean(floor.loud[3:] ** 2))))
    return ImuNoise(gyro=gyro, accel=accel, gyro_walk=config.gyro_walk, accel_walk=config.accel_walk)


def white_floor(grid: Grid) -> WhiteFloor:
    """Return the white noise of a moving IMU, by Whittle's likelihood of its high-frequency spectrum.

    Bodies move slowly, noise is as strong at all frequencies. The spectrum is therefore taken as one level over a
    range of bands and a level of its own in every other band; the range is the one under which the spectrum is most
    likely, less a price for each level (BIC). Windows in which the top half of the spectrum is more than twice as
    strong as in the quietest are left out: a motor, a kerb, a blow.

    Parameters
    ----------
    grid : Grid
        The whole recording; see `heliograph.imu.stretches.even_stretches`.

    Raises
    ------
    DataError
        Not a stretch of 40 samples.

    Notes
    -----
    Eqs. (9) and (10) of docs/theory/noise.md. P. Whittle, "Estimation and information in stationary time series", 1953.
    """
    size = _window_size(grid)
    power, freedom = _spectra(grid, size)
    frequency = np.arange(1, size // 2) / (size * grid.period)
    top = power[:, len(frequency) // 2 :].mean(axis=1)
    shares, floors = [], []
    for first in (0, 3):
        level = top[:, first : first + 3].sum(axis=1)
        calm = level <= _CALM_RATIO * np.quantile(level, 0.1)
        shares.append(float(calm.mean()))
        floors += [_read_floor(frequency, power[:, :, k], calm, freedom) for k in range(first, first + 3)]
    return WhiteFloor(
        density=np.array([floor.density for floor in floors]),
        sigma=np.array([floor.sigma for floor in floors]),
        loud=np.array([floor.loud for floor in floors]),
        band=np.array([floor.band for floor in floors]),
        flat=np.array([floor.flat for floor in floors]),
        calm=min(shares),
        frequency=frequency,
        spectrum=np.stack([floor.spectrum for floor in floors], axis=1),
    )


def _window_size(grid: Grid) -> int:
    longest = max((len(stretch) for stretch in grid.stretches), default=0)
    if longest < _MIN_SAMPLES:
        raise DataError(
            f"{longest} IMU samples in a row; a spectrum needs at least {_MIN_SAMPLES} - record a second or more"
        )
    wanted = max(round(_WINDOW / grid.period), _USUAL_SAMPLES)
    return 2 * (min(wanted, max(longest // 4, _MIN_SAMPLES)) // 2)


def _spectra(grid: Grid, size: int) -> tuple[Array, float]:
    """Return two-sided densities (windows, bins, 6) of overlapping windows, and the degrees of freedom of them all."""
    phase = 2.0 * np.pi * (np.arange(size) + 0.5) / size
    taper = np.cos(np.outer(phase, np.arange(len(_TAPER)))) @ np.array(_TAPER)
    scale = grid.period / float((taper**2).sum())
    hop, spectra, weight, weight_squared = size // 2, [], 0.0, 0.0
    for stretch in grid.stretches:
        count = (len(stretch) - size) // hop + 1
        covered = np.zeros(len(stretch))
        for k in range(max(count, 0)):
            piece = stretch.samples[k * hop : k * hop + size]
            transform = np.fft.rfft((piece - piece.mean(axis=0)) * taper[:, None], axis=0)
            spectra.append(scale * np.abs(transform[1:-1]) ** 2)
            covered[k * hop : k * hop + size] += taper**2
        weight += float(covered.sum())
        weight_squared += float((covered**2).sum())
    return np.stack(spectra), weight**2 / weight_squared


@dataclass(frozen=True, slots=True, kw_only=True)
class _Floor:
    """One channel's part of the result."""

    density: float
    sigma: float
    loud: float
    band: tuple[float, float]
    flat: bool
    spectrum: Array

    def __post_init__(self) -> None:
        freeze(self)


def _read_floor(frequency: Array, power: Array, calm: NDArray[np.bool_], freedom: float) -> _Floor:
    """Read one channel's floor from the power of its windows (windows, bins)."""
    bins = power.shape[1]
    edges = np.rint(np.linspace(0, bins, _BANDS + 1)).astype(np.int64)
    quiet = power[calm]
    levels = np.add.reduceat(quiet.mean(axis=0), edges[:-1]) / np.diff(edges)
    share = freedom * float(calm.mean())
    first, last = _floor_range(levels, share * np.diff(edges) / bins)
    inside = slice(int(edges[first]), int(edges[last]))
    by_window = quiet[:, inside].mean(axis=1)
    level = float(by_window.mean())
    width = (edges[last] - edges[first]) / bins
    expected = 2.0 / (share * width)
    # Where the level wanders more from window to window than noise does, its mean is known that much worse.
    found = float(by_window.var()) / len(by_window) / max(level, _TINY) ** 2
    step = frequency[0]
    # Any sampled spectrum levels off towards half the rate; a slope that is left shows that it comes from below.
    half = (edges[first] + edges[last]) // 2
    lower, upper = (quiet[:, part].mean() for part in (slice(edges[first], half), slice(half, edges[last])))
    slope = abs(float(np.log(max(lower, _TINY) / max(upper, _TINY))))
    level_off = slope <= _MAX_SLOPE + 3.0 * np.sqrt(4.0 * expected)
    return _Floor(
        density=float(np.sqrt(level)),
        sigma=float(0.5 * np.sqrt(level) * np.sqrt(max(expected, found))),
        loud=float(np.sqrt(power[:, inside].mean())),
        band=(float(frequency[edges[first]] - 0.5 * step), float(frequency[edges[last] - 1] + 0.5 * step)),
        flat=bool(last - first >= _FLAT_BANDS and level > 0.0 and level_off),
        spectrum=np.sqrt(quiet.mean(axis=0)),
    )


def _floor_range(levels: Array, freedom: Array) -> tuple[int, int]:
    """Return the first band of the floor and the one after its last, eq. (10)."""
    # No real spectrum is flat to the last digit, so a band is not known better than the tolerance.
    nu = 1.0 / (1.0 / freedom + 0.5 * _BAND_TOLERANCE**2)
    levels = np.maximum(levels, _TINY)
    best, chosen = np.inf, (_BANDS - 1, _BANDS)
    for first in range(_BANDS):
        for last in range(first + 1, _BANDS + 1):
            part = slice(first, last)
            shared = float((nu[part] * levels[part]).sum() / nu[part].sum())
            misfit = float((nu[part] * (levels[part] / shared - 1.0 - np.log(levels[part] / shared))).sum())
            price = (_BANDS - (last - first)) * float(np.log(nu.sum()))
            if misfit + price < best:
                best, chosen = misfit + price, (first, last)
    return chosen
