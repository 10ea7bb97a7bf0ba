"""The likelihood of a channel's spectrum under a sum of noise terms and a ramp, and where it is greatest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.imu.bands import Bands
from heliograph.imu.noise_terms import TERMS, term_spectra

__all__ = ["Fit", "maximise"]


_MAX_ROUNDS, _MAX_HALVINGS = 60, 12
_MAX_STEP = 2.0  # of the logarithm of a squared coefficient
_SETTLED_GAIN = 1e-7  # gain in log-likelihood that ends the search
_ZERO_POWER = 1e-30
_TRACE_SHARE = 1e-3  # share of the density, where it is largest, below which a term ended at nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """The most likely coefficients.

    Parameters
    ----------
    names : tuple of str
        The terms fitted.
    squares : (j,) float64
        Their squared coefficients.
    log_covariance : (j, j) float64
        Covariance of the logarithms of ``squares``.
    ramp, ramp_sigma : float
        Rate of change of the channel and its standard deviation [unit/s].
    log_likelihood : float
        Up to a constant of the record.
    """

    names: tuple[str, ...]
    squares: Array
    log_covariance: Array
    ramp: float
    ramp_sigma: float
    log_likelihood: float

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True)
class _Point:
    """The likelihood and its derivatives at one set of squared coefficients."""

    value: float
    gradient: Array
    information: Array
    ramp: float
    ramp_sigma: float

    def __post_init__(self) -> None:
        freeze(self)


def maximise(bands: Bands, names: Sequence[str], start: Fit | None = None, *, fixed: Array | None = None) -> Fit:
    """Return the squared coefficients under which the spectrum is most likely.

    Parameters
    ----------
    bands : Bands
    names : sequence of str
        Terms to fit, of `heliograph.imu.noise_terms.TERMS`.
    start : Fit, optional
        Where to begin; terms that it lacks begin from the data.
    fixed : (b,) float64, optional
        A density that is there besides [unit^2/Hz].

    Notes
    -----
    Eq. (6) of docs/theory/noise.md: the restricted likelihood, in which the ramp is a regression whose uncertainty the
    random walk's is cleared of. Fisher's scoring on logarithms of the squared coefficients, eq. (7), with steps limited
    and halved until the likelihood rises; a term that the data do not want runs off towards zero, where it has no
    effect any more.
    """
    shapes = term_spectra(bands.frequency, bands.period)[[TERMS.index(name) for name in names]]
    rest = np.zeros(len(bands.frequency)) if fixed is None else fixed
    squares = _start(bands, names, shapes, start)
    point = _likelihood(bands, shapes, rest, squares)
    for _ in range(_MAX_ROUNDS):
        step = _step(point, squares)
        for _ in range(_MAX_HALVINGS):
            trial = squares * np.exp(step)
            there = _likelihood(bands, shapes, rest, trial)
            if there.value > point.value:
                break
            step = 0.5 * step
        else:
            break
        gain, squares, point = there.value - point.value, trial, there
        if gain < _SETTLED_GAIN:
            break
    return Fit(
        names=tuple(names),
        squares=squares,
        log_covariance=_log_covariance(point, squares, shapes, rest),
        ramp=point.ramp,
        ramp_sigma=point.ramp_sigma,
        log_likelihood=point.value,
    )


def _log_covariance(point: _Point, squares: Array, shapes: Array, rest: Array) -> Array:
    """Return the inverse information of the logarithms; a term that ended at nothing takes no part and gets zeros."""
    share = (squares[:, None] * shapes / (rest + squares @ shapes)).max(axis=1)
    active = np.ix_(share > _TRACE_SHARE, share > _TRACE_SHARE)
    information = (point.information * np.outer(squares, squares))[active]
    covariance = np.zeros((len(squares), len(squares)))
    covariance[active] = np.linalg.pinv(information, hermitian=True)
    return covariance


def _start(bands: Bands, names: Sequence[str], shapes: Array, start: Fit | None) -> Array:
    """Begin where each term alone would explain the quietest part of what it touches."""
    known = dict(zip(start.names, start.squares, strict=True)) if start is not None else {}
    smooth = _smoothed(bands)
    return np.array(
        [
            max(known.get(name, 0.0), _ZERO_POWER)
            if name in known
            else max(0.5 * float(np.min(smooth / shape)), _ZERO_POWER)
            for name, shape in zip(names, shapes, strict=True)
        ]
    )


def _smoothed(bands: Bands) -> Array:
    """Return the spectrum averaged over about eight coefficients, for a start that no chance dip misleads."""
    order = np.argsort(bands.frequency, kind="stable")
    group = np.floor(np.cumsum(np.minimum(bands.count[order], 8.0)) / 8.0).astype(np.int64)
    _, group = np.unique(group, return_inverse=True)
    weight = np.bincount(group, bands.count[order])
    mean = np.bincount(group, bands.count[order] * bands.power[order]) / weight
    smooth = np.empty(len(order))
    smooth[order] = mean[group]
    return np.maximum(smooth, _ZERO_POWER)


def _likelihood(bands: Bands, shapes: Array, rest: Array, squares: Array) -> _Point:
    """Return eq. (6) with its gradient and its expected information with regard to the squared coefficients."""
    w = 1.0 / (rest + squares @ shapes)
    leverage = w * bands.ramp**2
    s = float(leverage.sum())
    ramp = float((w * bands.ramp * bands.root).sum()) / s
    power = bands.power - 2.0 * ramp * bands.ramp * bands.root + (ramp * bands.ramp) ** 2
    value = -0.5 * float((bands.count * (power * w - np.log(w))).sum()) - 0.5 * np.log(s)
    slope = 0.5 * bands.count * w * (power * w - 1.0) + 0.5 * leverage * w / s
    curve = 0.5 * bands.count * w**2 - leverage * w**2 / s
    pull = shapes @ (leverage * w) / s
    information = (shapes * curve) @ shapes.T + 0.5 * np.outer(pull, pull)
    return _Point(float(value), shapes @ slope, information, ramp, s**-0.5)


def _step(point: _Point, squares: Array) -> Array:
    """Return Fisher's step in the logarithms of the squared coefficients, eq. (7)."""
    gradient = point.gradient * squares
    information = point.information * np.outer(squares, squares)
    diagonal = np.maximum(np.diag(information), _ZERO_POWER)
    scale = 1.0 / np.sqrt(diagonal)
    # A little damping: terms that look alike in this record would otherwise leave for opposite infinities.
    normal = information * np.outer(scale, scale) + 1e-6 * np.eye(len(squares))
    step = np.zeros(len(squares))
    free = np.ones(len(squares), dtype=bool)
    while free.any():
        pull = scale * gradient - normal @ (step / scale)
        solved = scale[free] * np.linalg.solve(normal[np.ix_(free, free)], pull[free])
        step[free] = np.clip(solved, -_MAX_STEP, _MAX_STEP)
        too_long = np.flatnonzero(free)[np.abs(solved) > _MAX_STEP]
        if not len(too_long):
            break
        # What is stopped short no longer pulls the others along: they are solved for anew.
        free[too_long] = False
        step[free] = 0.0
    return step
