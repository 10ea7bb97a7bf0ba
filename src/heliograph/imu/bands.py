"""The spectrum of a channel at rest, in bands whose scatter is known: what the noise terms are fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze

__all__ = ["Bands", "band_spectrum"]


_SINGLE_COUNT = 128  # coefficients that are kept one by one before bands begin
_PER_OCTAVE = 32  # bands
_FIRST_LINE, _BLOCK = 1024, 256  # the coefficient from which lines are looked for, and neighbours they are held against
_LINE_RATIO = (
    30.0  # a coefficient at this multiple of its neighbours' level stands out: by chance once in some millions
)
_LINE_WIDTH = 16  # coefficients; three that stand out this close to each other are one line


@dataclass(frozen=True, slots=True, kw_only=True)
class Bands:
    """Mean squares of cosine coefficients, scaled to a spectral density.

    Parameters
    ----------
    frequency : (b,) float64
        [Hz].
    power : (b,) float64
        Two-sided spectral density; its expectation is the true one [unit^2/Hz].
    count : (b,) float64
        Coefficients in each; ``count * power / truth`` is chi-square with this many degrees of freedom.
    root : (b,) float64
        The coefficient itself where the band holds a single one, else 0 [unit/sqrt(Hz)].
    ramp : (b,) float64
        What a ramp of one unit a second adds to ``root`` [s^0.5].
    period : float
        Between samples [s].
    lines : tuple of float
        Frequencies of narrow peaks that were left out [Hz].
    """

    frequency: Array
    power: Array
    count: Array
    root: Array
    ramp: Array
    period: float
    lines: tuple[float, ...]

    def __post_init__(self) -> None:
        freeze(self)

    def below(self, frequency: float) -> Bands:
        """Return the bands up to a frequency [Hz]."""
        keep = self.frequency <= frequency
        return Bands(
            frequency=self.frequency[keep],
            power=self.power[keep],
            count=self.count[keep],
            root=self.root[keep],
            ramp=self.ramp[keep],
            period=self.period,
            lines=self.lines,
        )


def band_spectrum(signals: Sequence[Array], period: float) -> Bands:
    """Return the banded spectrum of one channel's stretches.

    Parameters
    ----------
    signals : sequence of (n,) float64
        One for each stretch, n at least 8.
    period : float
        Between samples [s].

    Notes
    -----
    Eq. (5) of docs/theory/noise.md. The cosine transform (DCT-II) is the exact eigenbasis of a random walk seen through
    white noise from an unknown start, so coefficient k is independent of the others with variance ``S(k / 2nT) / T``,
    without the leakage that a periodogram of a wandering signal has. A ramp shows in its lowest odd coefficients alone.
    """
    parts = [_stretch_bands(signal, period) for signal in signals]
    columns = [np.concatenate([part[i] for part in parts]) for i in range(5)]
    lines = sorted({round(f, 3) for part in parts for f in part[5]})
    return Bands(
        frequency=columns[0],
        power=columns[1],
        count=columns[2],
        root=columns[3],
        ramp=columns[4],
        period=period,
        lines=tuple(lines),
    )


def cosine_coefficients(signal: Array) -> Array:
    """Return the orthonormal DCT-II of a signal without its first (the mean), (n - 1,).

    One FFT of the signal's even samples and its odd ones backwards (J. Makhoul, "A fast cosine transform in one
    and two dimensions", IEEE Trans. ASSP 28, 1980).
    """
    n = len(signal)
    folded = np.concatenate([signal[::2], signal[1::2][::-1]])
    turned = np.fft.rfft(folded)
    turned *= np.exp(-0.5j * np.pi * np.arange(len(turned)) / n)
    coefficients = np.empty(n)
    coefficients[: len(turned)] = turned.real
    coefficients[len(turned) :] = -turned.imag[1 : n - len(turned) + 1][::-1]  # coefficient n - k hides beside k
    return np.asarray(np.sqrt(2.0 / n) * coefficients[1:])


def ramp_coefficients(n: int, count: int) -> Array:
    """Return the first ``count`` of what `cosine_coefficients` makes of 0, 1, ..., n - 1, in closed form."""
    k = np.arange(1, count + 1)
    half = 0.5 * np.pi * k / n
    return np.where(k % 2 == 1, -np.sqrt(0.5 / n) * np.cos(half) / np.sin(half) ** 2, 0.0)


def _stretch_bands(signal: Array, period: float) -> tuple[Array, Array, Array, Array, Array, list[float]]:
    """Return frequency, power, count, root and ramp of each band of one stretch, and the lines left out."""
    n = len(signal)
    root = np.sqrt(period) * cosine_coefficients(signal - signal.mean())
    frequency = np.arange(1, n) / (2.0 * n * period)
    single = min(_SINGLE_COUNT, n - 1)
    ramp = period**1.5 * ramp_coefficients(n, single)
    power = root[single:] ** 2
    line = np.zeros(len(power), dtype=bool)
    line[_FIRST_LINE:] = _lines(power[_FIRST_LINE:])
    edges = np.unique(np.rint(single * 2.0 ** (np.arange(1, 32 * _PER_OCTAVE) / _PER_OCTAVE)).astype(np.int64) - single)
    starts = np.concatenate([[0], edges[edges < len(power)]]).astype(np.int64)
    starts = starts[starts < len(power)]
    if len(starts):
        kept = np.add.reduceat((~line).astype(np.float64), starts)
        total = np.add.reduceat(np.where(line, 0.0, power), starts)
        logs = np.add.reduceat(np.where(line, 0.0, np.log(frequency[single:])), starts)
        filled = kept > 0.0
        kept, total, logs = kept[filled], total[filled], logs[filled]
    else:
        kept = total = logs = np.zeros(0)
    none = np.zeros(len(kept))
    return (
        np.concatenate([frequency[:single], np.exp(logs / np.maximum(kept, 1.0))]),
        np.concatenate([root[:single] ** 2, total / np.maximum(kept, 1.0)]),
        np.concatenate([np.ones(single), kept]),
        np.concatenate([root[:single], none]),
        np.concatenate([ramp, none]),
        _peaks(frequency[single:], line),
    )


def _lines(power: Array) -> NDArray[np.bool_]:
    """Tell which coefficients stand out of their neighbours: hum and fans, not noise of the sensor."""
    blocks = len(power) // _BLOCK
    if not blocks:
        return np.zeros(len(power), dtype=bool)
    level = np.median(power[: blocks * _BLOCK].reshape(blocks, _BLOCK), axis=1) / 0.4549  # the median of chi-square(1)
    # The neighbouring blocks' levels count too: where the spectrum falls, a block's own is too low for its first half.
    padded = np.concatenate([level[:1], level, level[-1:]])
    level = np.maximum(np.maximum(padded[:-2], padded[2:]), level)
    every = np.repeat(level, _BLOCK)
    every = np.concatenate([every, np.full(len(power) - len(every), level[-1])])
    return np.asarray(power > _LINE_RATIO * every) & (every > 0.0)


def _peaks(frequency: Array, line: NDArray[np.bool_]) -> list[float]:
    """Return one frequency for each group of neighbouring lines; a lone coefficient may be chance and is left out."""
    places = np.flatnonzero(line)
    if not len(places):
        return []
    groups = np.split(places, np.flatnonzero(np.diff(places) > _LINE_WIDTH) + 1)
    return [float(np.median(frequency[group])) for group in groups if len(group) >= 3]
