"""How strong each noise term is, by maximum likelihood, and what the record cannot tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.imu.bands import Bands
from heliograph.imu.noise_likelihood import Fit, maximise
from heliograph.imu.noise_terms import RAMP, TERMS, spectrum, term_spectra

__all__ = ["ChannelNoise", "TermEstimate", "fit_channel"]


_SHOWN_GAIN = 9.0  # twice the gain in log-likelihood that a term must bring: by chance once in 740 records
_BOUND_GAIN = 2.706  # the same, for a one-sided bound that holds with 95 %
_DISTINCT_GAIN = 6.0  # the same by which one of flicker and walk must beat the other: one is twenty times as likely
_AKAIKE_GAIN = 2.0  # the same, for a term that is worth its coefficient without being shown (Akaike)
_RAMP_SHOWN_SIGMAS, _RAMP_BOUND_SIGMAS = 3.0, 1.645
_SLOW_TERMS = ("flicker", "walk")
_TOP_OCTAVES = 4  # that may be given up where the sensor's filter bends the spectrum
_TOP_MISFIT = 0.15  # by how much an octave may miss the fit
_MIN_RATIO = 1e-12  # power of an octave by that of the fit, where there is none


@dataclass(frozen=True, slots=True, kw_only=True)
class TermEstimate:
    """One coefficient.

    Parameters
    ----------
    name : str
        One of `heliograph.imu.noise_terms.TERMS`, or ``"ramp"``.
    value : float or None
        In the units of IEEE 952, SI; None where the record does not show the term.
    sigma : float or None
        One standard deviation of ``value``.
    upper : float
        With 95 % confidence the coefficient is not above this.
    """

    name: str
    value: float | None
    sigma: float | None
    upper: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelNoise:
    """The noise of one channel.

    Parameters
    ----------
    terms : tuple of TermEstimate
        Quantisation Q, white N, flicker B, walk K and ramp R.
    model : Mapping of str to float
        Squared coefficients of the sum of terms that was fitted.
    told_apart : bool
        False where the record rises slowly but flicker and walk explain that alike; neither is then given a value.
    walk_of_filter : TermEstimate
        The random walk that explains the record best without flicker: what a filter's bias model needs, which knows
        white noise and a walk.
    top : float
        Highest frequency used; above it the sensor's own filter bends the spectrum [Hz].
    misfit : float
        Largest relative difference of an octave of the spectrum from the fit that is not chance; 0 if none.
    lines : tuple of float
        Frequencies of narrow peaks that were left out [Hz].
    """

    terms: tuple[TermEstimate, ...]
    model: Mapping[str, float]
    told_apart: bool
    walk_of_filter: TermEstimate
    top: float
    misfit: float
    lines: tuple[float, ...]

    def term(self, name: str) -> TermEstimate:
        """Return a term by name."""
        return next(term for term in self.terms if term.name == name)


def fit_channel(bands: Bands) -> ChannelNoise:
    """Fit the noise terms to a channel's spectrum.

    A term is kept if without it the record is much less likely (a likelihood ratio); what is not kept gets an upper
    bound from where the likelihood has dropped by as much as a one-sided 95 % test allows, all else fitted anew. The
    top octaves are given up while they miss the fit: many IMUs low-pass their output.

    Parameters
    ----------
    bands : Bands
        From `heliograph.imu.bands.band_spectrum`.

    Notes
    -----
    Eqs. (6) to (8) of docs/theory/noise.md.
    """
    if not bands.power.any():
        return _silent(float(bands.frequency.max()))
    used, fit, told_apart = _trimmed(bands)
    simple, _ = _selected(used, ("quantisation", "white", "walk"))
    shown = [name for name in fit.names if told_apart or name not in _SLOW_TERMS]
    if any(name in _SLOW_TERMS for name in fit.names):
        # A walk too weak to be shown still adds to what would else all be taken for flicker, and the other way round.
        both = maximise(used, [name for name in TERMS if name in fit.names or name in _SLOW_TERMS], fit)
        if not told_apart or 2.0 * (both.log_likelihood - fit.log_likelihood) > _AKAIKE_GAIN:
            fit = both
    terms = tuple(_estimate(name, fit, used, shown) for name in TERMS)
    walk = next(term for term in terms if term.name == "walk")
    return ChannelNoise(
        terms=(*terms, _ramp(fit, walk, used)),
        model=dict(zip(fit.names, fit.squares.tolist(), strict=True)),
        told_apart=told_apart,
        walk_of_filter=_estimate("walk", simple, used, simple.names),
        top=float(used.frequency.max()),
        misfit=float(np.expm1(_worst(used, fit))),
        lines=used.lines,
    )


def _silent(top: float) -> ChannelNoise:
    """Return what a channel tells that never changes: nothing."""
    terms = tuple(TermEstimate(name=name, value=None, sigma=None, upper=0.0) for name in (*TERMS, RAMP))
    walk = next(term for term in terms if term.name == "walk")
    return ChannelNoise(terms=terms, model={}, told_apart=True, walk_of_filter=walk, top=top, misfit=0.0, lines=())


def _trimmed(bands: Bands) -> tuple[Bands, Fit, bool]:
    """Fit, and fit again without the top octave as long as the fit misses an octave and gains by it."""
    best = (bands, *_selected(bands, TERMS))
    least = _worst(*best[:2])
    used = bands
    for _ in range(_TOP_OCTAVES):
        octaves = _octaves(used, best[1])
        if least < _TOP_MISFIT or not octaves:
            break
        used = used.below(octaves[0][0])
        fit, told_apart = _selected(used, TERMS)
        worst = _worst(used, fit)
        # What is given up must pay: a record that is odd at low frequencies stays so whatever is cut off at the top.
        if worst < max(0.5 * least, _TOP_MISFIT):
            best, least = (used, fit, told_apart), worst
    return best


def _worst(bands: Bands, fit: Fit) -> float:
    """Return the largest difference of an octave from the fit that is not chance; too much counts like too little."""
    # An octave without any power, as a constant channel's, is as wrong as can be, but not infinitely.
    ratios = (max(1.0 + miss, _MIN_RATIO) for _, miss in _octaves(bands, fit))
    return max((abs(float(np.log(ratio))) for ratio in ratios), default=0.0)


def _selected(bands: Bands, names: Sequence[str]) -> tuple[Fit, bool]:
    """Drop the terms that the record does not show, the least shown first; white noise always stays.

    Also told is whether flicker and walk, where one of them is left, can be told from each other.
    """
    kept = list(names)
    fit = maximise(bands, kept)
    while len(kept) > 1:
        rivals = {name: maximise(bands, [k for k in kept if k != name], fit) for name in kept if name != "white"}
        least = max(rivals, key=lambda name: rivals[name].log_likelihood)
        if 2.0 * (fit.log_likelihood - rivals[least].log_likelihood) >= _SHOWN_GAIN:
            break
        kept.remove(least)
        fit = rivals[least]
    slow = [name for name in kept if name in _SLOW_TERMS]
    if len(slow) != 1 or "flicker" not in names:
        return fit, True
    other = maximise(
        bands, [name for name in kept if name not in _SLOW_TERMS] + [n for n in _SLOW_TERMS if n not in slow]
    )
    return fit, 2.0 * (fit.log_likelihood - other.log_likelihood) >= _DISTINCT_GAIN


def _estimate(name: str, fit: Fit, bands: Bands, shown: Sequence[str]) -> TermEstimate:
    if name in shown:
        k = fit.names.index(name)
        value = float(np.sqrt(fit.squares[k]))
        spread = 0.5 * float(np.sqrt(fit.log_covariance[k, k]))
        return TermEstimate(name=name, value=value, sigma=value * spread, upper=value * float(np.exp(1.645 * spread)))
    upper = _upper(name, [other for other in fit.names if other != name], fit, bands)
    return TermEstimate(name=name, value=None, sigma=None, upper=upper)


def _upper(name: str, others: list[str], fit: Fit, bands: Bands) -> float:
    """Return the largest coefficient of a term that the record still allows, the others fitted anew."""
    shape = term_spectra(bands.frequency, bands.period)[TERMS.index(name)]
    with_it = maximise(bands, [*others, name], fit)

    def drop(square: float) -> float:
        return 2.0 * (with_it.log_likelihood - maximise(bands, others, fit, fixed=square * shape).log_likelihood)

    # From where it is most likely upwards; from nothing, if that is most likely, or from the first trace of it.
    trace = 1e-6 * float(np.min(bands.power.mean() / shape))
    low = high = max(float(with_it.squares[-1]), trace)
    while drop(high) < _BOUND_GAIN:
        low, high = high, 4.0 * high
    while high > 1.02 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if drop(middle) < _BOUND_GAIN else (low, middle)
    return float(np.sqrt(high))


def _ramp(fit: Fit, walk: TermEstimate, bands: Bands) -> TermEstimate:
    """Return the ramp; a walk that the record does not show may still be there and look like one."""
    if walk.value is None:
        shape = term_spectra(bands.frequency, bands.period)[TERMS.index("walk")]
        others = [name for name in fit.names if name != "walk"]
        fit = maximise(bands, others, fit, fixed=walk.upper**2 * shape)
    size = abs(fit.ramp)
    seen = size > _RAMP_SHOWN_SIGMAS * fit.ramp_sigma
    return TermEstimate(
        name=RAMP,
        value=size if seen else None,
        sigma=fit.ramp_sigma if seen else None,
        upper=size + _RAMP_BOUND_SIGMAS * fit.ramp_sigma,
    )


def _octaves(bands: Bands, fit: Fit) -> list[tuple[float, float]]:
    """Return, from the top down, each octave's lower edge and its relative excess over the fit where it is not chance.

    An octave within five sigma of the fit gets an excess of 0.
    """
    expected = spectrum(dict(zip(fit.names, fit.squares, strict=True)), bands.frequency, bands.period)
    ratio = (bands.power - 2.0 * fit.ramp * bands.ramp * bands.root + (fit.ramp * bands.ramp) ** 2) / expected
    edge, found = float(bands.frequency.max()), []
    while edge > 4.0 * float(bands.frequency.min()):
        inside = (bands.frequency > 0.5 * edge) & (bands.frequency <= edge)
        count = float(bands.count[inside].sum())
        if count < 16.0:
            break
        excess = float((bands.count[inside] * ratio[inside]).sum()) / count - 1.0
        found.append((0.5 * edge, excess if abs(excess) > 5.0 * np.sqrt(2.0 / count) else 0.0))
        edge *= 0.5
    return found
