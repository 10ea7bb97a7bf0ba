"""Which fixes to believe: graduated non-convexity on the odometry's chain, where the map lies on Earth being unknown.

References
----------
.. [1] H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception",
   RA-L 2020.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heliograph.arrays import Array, Mask
from heliograph.chi_square import chi_square_quantile
from heliograph.config import GnssConfig
from heliograph.slam.gnss.alignment import aligned_tracks, noise_scale
from heliograph.slam.gnss.chain import ChainSolution, FixChain
from heliograph.slam.gnss.evidence import FixEvidence, Judgement, Placement

__all__ = ["judge"]

_STEP = 2.0  # by which the surrogate is sharpened a round
_SHARP = 100.0  # sharpness at which weights are 0 or 1 but for a percent around the threshold
_FARTHEST = 1e4  # squared residuals above this many thresholds begin like that one
_ODOMETRY_SCALES = (1.0, 2.0, 4.0, 8.0)
_GAIN = 0.15  # share of the fixes that a weaker odometry must win to be believed weaker
_GROWN = 1.2  # a noise that is larger by less is as reported
_CORRELATED = 0.3  # autocorrelation from which residuals count as correlated
_LARGEST_SCALE = 30.0
_DELAYS = 0.05  # shift of the stamps at which the cost is compared [s]
_LONGEST = 2.0  # a delay beyond is not one [s]
_TOLD = 3.0  # sigmas that a delay must be away from zero
_LEAST_DELAY = 0.005  # [s]


def judge(evidence: FixEvidence, config: GnssConfig) -> Judgement:
    """Weigh the fixes against the odometry and against each other.

    The fixes' noise is measured first: between neighbours, and from what is left of those that are believed, with its
    correlation in time. Nothing is asked of how good they say they are, but that it is no better than that.

    Parameters
    ----------
    evidence : FixEvidence
        At least three fixes.
    config : GnssConfig
    """
    threshold = chi_square_quantile(config.acceptance, 3)
    placement = evidence.placed(0.0)
    T_map_enu = _start(evidence, placement)
    evidence, scale = _with_measured_noise(evidence, placement, T_map_enu)
    chain, weights, solution, odometry_scale = _odometry_weighed(evidence, placement, T_map_enu, threshold)
    if evidence.arm_sigma:
        chain = chain.about(solution.arm)
        weights, solution = _graduated(chain, solution, threshold)
    delay, delay_sigma = 0.0, float("nan")
    if config.correct_delay:
        delay, delay_sigma = _delay(chain, evidence, weights, solution)
        if delay:
            placement = evidence.placed(delay)
            chain = chain.moved(placement)
            weights, solution = _graduated(chain, solution, threshold)
    judged, grown = solution.squared, _left_over(evidence, weights, solution)
    if grown > _GROWN:
        evidence = replace(evidence, covariance=evidence.covariance * grown**2)
        # Weighed by it, but not judged again: a wider gate would let in what has just been told apart.
        chain = chain.weighed(evidence.covariance)
        solution = chain.solve(solution, weights)
    covariance_enu, arm_sigma = chain.marginals(solution, weights)
    return Judgement(
        placement=placement,
        weights=weights * placement.covered,
        covariance=evidence.covariance,
        squared=judged,
        residual=solution.residual,
        threshold=threshold,
        T_map_enu=solution.T_map_enu,
        covariance_enu=covariance_enu,
        arm=solution.arm,
        arm_sigma=arm_sigma,
        delay=delay,
        delay_sigma=delay_sigma,
        noise_scale=scale * max(grown, 1.0),
        odometry_scale=odometry_scale,
    )


def _antennas(evidence: FixEvidence, placement: Placement) -> Array:
    """Return the antenna by the odometry at each fix, (M, 3)."""
    T = evidence.T_odom_imu[placement.keyframe]
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], placement.points(evidence.arm)) + T[:, :3, 3])


def _start(evidence: FixEvidence, placement: Placement) -> Array:
    k = np.flatnonzero(placement.covered)
    sigma = np.sqrt(np.trace(evidence.covariance[k], axis1=1, axis2=2) / 3.0)
    level = bool(np.isfinite(evidence.level_sigma))
    T_enu_odom = aligned_tracks(_antennas(evidence, placement)[k], evidence.p_enu[k], sigma, level=level)
    T = np.eye(4)
    T[:3, :3] = T_enu_odom[:3, :3].T
    T[:3, 3] = -T[:3, :3] @ T_enu_odom[:3, 3]
    return T


def _with_measured_noise(evidence: FixEvidence, placement: Placement, T_map_enu: Array) -> tuple[FixEvidence, float]:
    """Return the evidence with covariances as large as the noise between neighbours, and the largest scale."""
    p_odom = _antennas(evidence, placement) @ T_map_enu[:3, :3]
    sigma = np.sqrt(np.einsum("nii->ni", evidence.covariance))
    scales = np.ones(len(evidence.p_enu))
    for solution in np.unique(evidence.solutions):
        same = (evidence.solutions == solution) & placement.covered
        scale = noise_scale(p_odom, evidence.p_enu, evidence.seconds, sigma, same)
        scales[evidence.solutions == solution] = scale if scale > _GROWN else 1.0
    return replace(evidence, covariance=evidence.covariance * scales[:, None, None] ** 2), float(
        scales.max(initial=1.0)
    )


def _odometry_weighed(
    evidence: FixEvidence, placement: Placement, T_map_enu: Array, threshold: float
) -> tuple[FixChain, Array, ChainSolution, float]:
    """Judge with the odometry as sure as it says, and weaker where only that lets it agree with the fixes."""
    best: tuple[FixChain, Array, ChainSolution, float] | None = None
    share = -np.inf
    for scale in _ODOMETRY_SCALES:
        chain = FixChain(evidence, placement, odometry_scale=scale)
        weights, solution = _graduated(chain, chain.start(T_map_enu), threshold)
        agree = float((weights * placement.covered).sum() / max(placement.covered.sum(), 1))
        if agree > share + _GAIN:
            best, share = (chain, weights, solution, scale), agree
        if share > 1.0 - _GAIN:
            break
    assert best is not None
    return best


def _graduated(chain: FixChain, solution: ChainSolution, threshold: float) -> tuple[Array, ChainSolution]:
    """Return weights and the solution of truncated least squares ([1]_, eqs. 11 and 14), from a convex surrogate on."""
    solution = chain.solve(solution, chain.covered)
    worst = min(float(solution.squared[chain.covered > 0.0].max(initial=0.0)), _FARTHEST * threshold)
    if worst <= threshold:
        return chain.covered, solution
    sharpness = threshold / max(2.0 * worst - threshold, threshold)
    weights = chain.covered
    while sharpness < _SHARP:
        weights = _truncated(solution.squared, threshold, sharpness) * chain.covered
        solution = chain.solve(solution, weights)
        sharpness *= _STEP
    for _ in range(3):
        before, weights = weights, _truncated(solution.squared, threshold, _SHARP) * chain.covered
        solution = chain.solve(solution, weights)
        if np.abs(before - weights).max() < 1e-3:
            break
    return weights, solution


def _truncated(squared: Array, threshold: float, sharpness: float) -> Array:
    low, high = sharpness / (sharpness + 1.0) * threshold, (sharpness + 1.0) / sharpness * threshold
    middle = np.sqrt(threshold * sharpness * (sharpness + 1.0) / np.maximum(squared, 1e-12)) - sharpness
    return np.where(squared <= low, 1.0, np.where(squared >= high, 0.0, np.clip(middle, 0.0, 1.0)))


def _left_over(evidence: FixEvidence, weights: Array, solution: ChainSolution) -> float:
    """Return what sigmas must grow by so that believed residuals fit them, each counted for as much as it is new."""
    used: Mask = weights > 0.5
    if used.sum() < 10:
        return 1.0
    white = solution.residual / np.sqrt(np.einsum("nii->ni", evidence.covariance))
    size = max(1.0, float(np.median(np.abs(white[used]))) / 0.6745)
    k = np.flatnonzero(used)
    pair = k[:-1][(np.diff(k) == 1) & (np.diff(evidence.seconds[k]) < 2.5)]
    rho = 0.0
    if len(pair) >= 20:
        rho = float((white[pair] * white[pair + 1]).sum() / max((white[pair] ** 2).sum(), 1e-12))
    correlated = np.sqrt((1.0 + rho) / (1.0 - min(rho, 0.999))) if rho > _CORRELATED else 1.0
    correlated = min(correlated, np.sqrt(used.sum()))  # all of one error still tell as much as one fix
    return float(min(size * correlated, _LARGEST_SCALE))


def _delay(chain: FixChain, evidence: FixEvidence, weights: Array, solution: ChainSolution) -> tuple[float, float]:
    """Return the delay of the stamps and its sigma, from the parabola of the cost; zero where it is not told."""
    delay, sigma = 0.0, float("nan")
    for _ in range(3):  # the cost is a parabola only near its bottom
        costs = []
        for shift in (-_DELAYS, 0.0, _DELAYS):
            moved = chain.moved(evidence.placed(delay + shift))
            costs.append(moved.solve(solution, weights).cost)
        curvature = (costs[0] - 2.0 * costs[1] + costs[2]) / _DELAYS**2
        if curvature <= 0.0:
            return 0.0, float("nan")
        step = (costs[0] - costs[2]) / (2.0 * _DELAYS) / curvature
        sigma = float(np.sqrt(2.0 / curvature))
        delay += float(np.clip(step, -0.5, 0.5))
        if abs(step) < 0.2 * sigma:
            break
    told = _TOLD * sigma < abs(delay) < _LONGEST and abs(delay) > _LEAST_DELAY
    return (delay if told else 0.0), sigma
