"""From coarse to fine: Gauss-Newton on each level of two prepared clouds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.config import AlignConfig
from heliograph.lie import se3
from heliograph.registration.remapping import seen_step
from heliograph.registration.surfaces import PreparedCloud

__all__ = ["METHODS", "LevelFit", "explored", "fit_levels", "level_matches", "refine"]

Array = NDArray[np.float64]

METHODS = {"point-to-point": 0, "point-to-plane": 1, "point-to-edge": 2, "gicp": 3, "vgicp": 3}
"""Residuals, by the native kernel's numbers."""

_KEEP = 0.1  # of a cube's edge: a smaller step leaves the partners as they are
_COARSE = 0.02  # of a cube's edge: a smaller step ends a coarse level
_LEVER = 10.0  # distance at which a rotation counts as a displacement [m]
_LOOSE = 1e-9  # of the information's diagonal, added to it: a step exists even where nothing is seen
_STEP_SIGMAS = 0.1  # a step shorter than this share of its own standard deviation ends a level
_MIN_KERNEL = 3.0  # of the residuals' spread, the narrowest kernel


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelFit:
    """Where the iterations ended.

    Parameters
    ----------
    T : (4, 4) float64
        Source to target.
    information : (6, 6) float64
        Information of the last normal equations.
    reduced_chi_square : float
        Weighted mean square of the whitened residuals.
    kernel : float
        The kernel's scale at the end [m].
    weight : float
        Sum of the robust weights.
    matches, iterations : int
    settled : bool
        Whether the last step was below the tolerance.
    matcher : object
        Matcher of the native core, with the partners found last.
    """

    T: Array
    information: Array
    reduced_chi_square: float
    kernel: float
    weight: float
    matches: int
    iterations: int
    settled: bool
    matcher: _core.Matcher

    def __post_init__(self) -> None:
        freeze(self)


def fit_levels(
    target: PreparedCloud,
    source: PreparedCloud,
    start: Array,
    method: str,
    config: AlignConfig,
    threads: int,
    *,
    levels: range | None = None,
) -> LevelFit:
    """Iterate on each level, the widest first, and with the chosen residual on the finest.

    The coarse levels use distributions whatever the method: they have the widest basin, and only lead to it.

    Parameters
    ----------
    target, source : PreparedCloud
    start : (4, 4) float64
        Source to target.
    method : str
        Key of `METHODS`.
    config : AlignConfig
    threads : int
    levels : range, optional
        Which, in order; all if not given.
    """
    T, spent, fit = np.ascontiguousarray(start), 0, None
    for level in levels if levels is not None else range(target.native.levels() - 1, -1, -1):
        fit = _fit(target, source, T, method if level == 0 else "gicp", level, config, threads, None)
        T, spent = fit.T, spent + fit.iterations
    assert fit is not None
    return _with_iterations(fit, spent)


def refine(
    target: PreparedCloud,
    source: PreparedCloud,
    fit: LevelFit,
    method: str,
    config: AlignConfig,
    threads: int,
    blind: Array,
) -> LevelFit:
    """Iterate on the finest level from ``fit.T`` without moving along ``blind`` (6, K)."""
    again = _fit(target, source, fit.T, method, 0, config, threads, blind)
    return _with_iterations(again, fit.iterations + again.iterations)


def explored(
    target: PreparedCloud,
    source: PreparedCloud,
    fit: LevelFit,
    start: Array,
    blind: Array,
    method: str,
    config: AlignConfig,
    threads: int,
) -> LevelFit | None:
    """Return a better fit from starts along what ``fit`` leaves blind (6, K), or None.

    A fit that sees the ground only may be one whose walls found no partner. The starts are up to two of the start's own
    sigmas away, and are tried on the two widest levels.
    """
    top = target.native.levels() - 1
    if top < 1:
        return None
    coarse = range(top, top - 2, -1)
    sigma = np.concatenate([np.full(3, np.radians(config.start_sigma_deg)), np.full(3, config.start_sigma)])
    reference = fit_levels(target, source, fit.T, "gicp", config, threads, levels=coarse)
    best = reference
    for column in blind.T:
        unit = column / np.linalg.norm(column / sigma)
        for steps in (-2.0, -1.0, 1.0, 2.0):
            there = np.ascontiguousarray(se3.retract(start, steps * unit))
            some = fit_levels(target, source, there, "gicp", config, threads, levels=coarse)
            best = some if some.weight > best.weight else best
    if best is reference:
        return None
    again = fit_levels(target, source, best.T, method, config, threads, levels=range(max(top - 2, 0), -1, -1))
    return _with_iterations(again, fit.iterations + again.iterations) if again.weight > fit.weight else None


def _with_iterations(fit: LevelFit, iterations: int) -> LevelFit:
    return LevelFit(
        T=fit.T,
        information=fit.information,
        reduced_chi_square=fit.reduced_chi_square,
        kernel=fit.kernel,
        weight=fit.weight,
        matches=fit.matches,
        iterations=iterations,
        settled=fit.settled,
        matcher=fit.matcher,
    )


def _fit(
    target: PreparedCloud,
    source: PreparedCloud,
    T: Array,
    method: str,
    level: int,
    config: AlignConfig,
    threads: int,
    blind: Array | None,
) -> LevelFit:
    matcher = _core.Matcher(target.native, level, source.native, level, stride_of(source, level, config))
    gate, kernel, cosine = scales(config, level)
    residual, by_cube, sided = METHODS[method], method == "vgicp", one_sided(target, source)
    edge = config.voxel * 2.0**level if config.voxel > 0.0 else gate
    tolerance = config.tolerance if level == 0 else _COARSE * edge
    turn = np.radians(config.tolerance_deg) if level == 0 else tolerance / _LEVER
    keep, settled, H, chi, matches, k, since = False, False, np.zeros((6, 6)), float("nan"), 0, 0, 0.0
    weight = 0.0
    for k in range(1, config.iterations + 1):
        sums = matcher.sums(T, residual, by_cube, gate, kernel, config.sigma, cosine, sided, keep, threads)
        H, g, _, weight, square, whitened, matches = sums
        if matches < 6 or weight <= 0.0:
            break
        chi = whitened / weight
        d = _step(H, g, blind)
        T = _retracted(T, d)
        turned, shifted = max(map(abs, d[:3].tolist())), max(map(abs, d[3:].tolist()))
        moved = shifted + _LEVER * turned
        # Partners found at nearly this pose are those of this pose: the search is most of an iteration's time.
        since = moved if not keep else since + moved
        keep = since < _KEEP * edge and config.voxel > 0.0
        if level == 0 and k == 2 and kernel > 0.0:
            kernel = float(np.clip(_MIN_KERNEL * np.sqrt(square / weight), 4.0 * config.sigma, kernel))
        # Where nothing is seen a step stays long; one that the matches cannot tell from none ends the level too.
        settled = (shifted < tolerance and turned < turn) or float(d @ H @ d) < _STEP_SIGMAS**2
        if settled:
            break
    return LevelFit(
        T=T,
        information=np.asarray(H),
        reduced_chi_square=chi,
        kernel=kernel,
        weight=weight,
        matches=matches,
        iterations=k,
        settled=settled,
        matcher=matcher,
    )


def _step(H: Array, g: Array, blind: Array | None) -> Array:
    held = H.copy()
    held.ravel()[::7] *= 1.0 + _LOOSE
    held.ravel()[::7] += _LOOSE
    return np.asarray(-np.linalg.solve(held, g)) if blind is None else seen_step(held, g, blind)


def _retracted(T: Array, d: Array) -> Array:
    """``T exp(d)`` without the checks of `heliograph.lie`: a scan's iterations are a third of a millisecond each."""
    out = np.empty((1, 4, 4))
    _core.se3_exp(d[None], out)
    return np.asarray(T @ out[0])


def one_sided(target: PreparedCloud, source: PreparedCloud) -> bool:
    """Whether both clouds are taken for scans seen from their origins."""
    return target.config.one_sided and not (target.origin.any() or source.origin.any())


def stride_of(source: PreparedCloud, level: int, config: AlignConfig) -> int:
    """Return every how-many-th element of a level is matched: 1 where there are no more than `max_elements`."""
    return max(1, -(-source.native.size(level) // config.max_elements)) if config.max_elements else 1


def scales(config: AlignConfig, level: int) -> tuple[float, float, float]:
    """Return gate [m], kernel [m] and least cosine between normals of a level."""
    edge = config.voxel * 2.0**level if config.voxel > 0.0 else 1.0
    return config.gate * edge, config.kernel * edge, config.min_cosine if level < 2 else 0.0


def level_matches(
    target: PreparedCloud, source: PreparedCloud, T: Array, method: str, level: int, kernel: float, config: AlignConfig,
    threads: int, *, matcher: _core.Matcher | None = None,
) -> Array:  # fmt: skip
    """Return one row a match: point 3, normal 3 (source frame), residual, distance, weight, variance, tilt, elements 2.

    ``tilt`` is the variance of the normal's direction [rad^2]; the normal is zero where the target has no plane. A
    ``matcher`` of this level that was used at nearly this pose saves most of the search.
    """
    if matcher is None:
        matcher = _core.Matcher(target.native, level, source.native, level, stride_of(source, level, config))
    gate, _, cosine = scales(config, level)
    residual, by_cube = METHODS[method], method == "vgicp"
    sided = one_sided(target, source)
    return np.asarray(matcher.matches(T, residual, by_cube, gate, kernel, config.sigma, cosine, sided, threads))
