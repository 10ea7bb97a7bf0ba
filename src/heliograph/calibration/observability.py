"""What the motion shows of the mounting and the clock, direction by direction, and in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.config import CalibrationConfig
from heliograph.lie import so3

__all__ = [
    "AXES",
    "CalibratedAxis",
    "Observed",
    "analyse",
    "difference",
    "judge_axes",
    "kept_in_words",
    "prior_sigmas",
    "useful_sigmas",
]


AXES = (
    "rotation about x",
    "rotation about y",
    "rotation about z",
    "lever arm along x",
    "lever arm along y",
    "lever arm along z",
    "clock offset",
    "clock drift",
)
_KINDS = (("rotation about", slice(0, 3)), ("lever arm along", slice(3, 6)))
_REMEDIES = {
    "rotation about": "turn about another axis too",
    "lever arm along": "turn about an axis across it",
    "clock offset": "turn faster, and back and forth",
    "clock drift": "record for longer, with turns at both ends",
}
_CAUSE_SHARE = 0.5  # share of a variance beyond which one part of it is named as its cause


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """The eight numbers of a calibration in the directions that prior and data weigh alike.

    With the prior's information L and the data's A the directions V solve ``A v = gain^2 L v`` with ``V^T L V = I``,
    so that they are independent in both, eq. (7) of docs/theory/calibration.md. Axes are the IMU's.

    Parameters
    ----------
    directions : (8, 8) float64
        As columns, each one prior sigma long: rotation about [rad], lever arm along [m], offset [s], drift [s/s].
    gains : (8,) float64
        How many times better than the prior the data tell each.
    kept : (8,) bool
        Which are not observed well enough and keep the prior.
    """

    directions: Array
    gains: Array
    kept: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def covariance(self) -> Array:
        """What is known in the end, (8, 8): the prior along what is kept, prior and data along the rest."""
        scale = np.where(self.kept, 1.0, 1.0 / np.sqrt(1.0 + self.gains**2))
        half = self.directions * scale
        return np.asarray(half @ half.T)

    @property
    def kept_covariance(self) -> Array:
        """The part of `covariance` (8, 8) that is the prior's alone."""
        half = self.directions[:, self.kept]
        return np.asarray(half @ half.T)

    def observed_part(self, difference: Array) -> Array:
        """Return the part (8,) of a difference between two calibrations that lies along what was observed."""
        observed = self.directions[:, ~self.kept]
        return np.asarray(observed @ (np.linalg.pinv(self.directions)[~self.kept] @ difference))


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedAxis:
    """The verdict on one number.

    Parameters
    ----------
    name : str
        One of `AXES`; axes are the IMU's.
    value, sigma, prior_sigma : float
        In SI units; the value of a rotation is the change from the prior.
    verdict : str
        ``"observed"``: known as well as is useful; ``"weak"``: observed, but not as well; ``"partly"``: its
        larger part lies along a direction that was not excited; ``"not excited"``: the prior was kept.
    remedy : str
        What motion would tell it; empty where observed.
    """

    name: str
    value: float
    sigma: float
    prior_sigma: float
    verdict: str
    remedy: str


def prior_sigmas(config: CalibrationConfig) -> Array:
    """Return one-sigma of the prior, (8,) in SI units."""
    rotation, drift = np.radians(config.prior_rotation_deg), 1e-6 * config.prior_drift_ppm
    return np.array([rotation] * 3 + [config.prior_lever] * 3 + [config.prior_offset, drift])


def useful_sigmas(config: CalibrationConfig) -> Array:
    """Return what counts as observed, (8,) in SI units."""
    rotation, drift = np.radians(config.useful_rotation_deg), 1e-6 * config.useful_drift_ppm
    return np.array([rotation] * 3 + [config.useful_lever] * 3 + [config.useful_offset, drift])


def analyse(covariance: Array, prior: Array, gain: float) -> Observed:
    """Tell what the data say from what the prior says.

    Parameters
    ----------
    covariance : (8, 8) float64
        Posterior, the prior included.
    prior : (8,) float64
        One-sigma of the independent prior on each axis.
    gain : float
        A direction whose sigma the data lower by less than this factor keeps the prior.
    """
    # In units of the prior its information is the identity, and the data's is the rest of the posterior's.
    scaled = covariance / np.outer(prior, prior)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    gains = np.sqrt(np.maximum(1.0 / np.clip(values, 1e-15, None) - 1.0, 0.0))
    return Observed(directions=prior[:, None] * vectors, gains=gains, kept=gains < gain)


def judge_axes(observed: Observed, values: Array, config: CalibrationConfig) -> tuple[CalibratedAxis, ...]:
    """Return the verdict on each of the eight numbers whose ``values`` (8,) are given."""
    prior, useful = prior_sigmas(config), useful_sigmas(config)
    variance, kept = np.diag(observed.covariance), np.diag(observed.kept_covariance)
    axes = []
    for k, name in enumerate(AXES):
        sigma = float(np.sqrt(variance[k]))
        if sigma <= useful[k]:
            verdict = "observed"
        elif kept[k] > _CAUSE_SHARE * prior[k] ** 2:
            verdict = "not excited"
        else:
            verdict = "partly" if kept[k] > _CAUSE_SHARE * variance[k] else "weak"
        kind = name.rsplit(" ", 1)[0] if k < 6 else name
        axes.append(
            CalibratedAxis(
                name=name,
                value=float(values[k]),
                sigma=sigma,
                prior_sigma=float(prior[k]),
                verdict=verdict,
                remedy="" if verdict == "observed" else _REMEDIES[kind],
            )
        )
    return tuple(axes)


def kept_in_words(observed: Observed, prior: Array) -> tuple[str, ...]:
    """Return one line for each direction that kept its prior."""
    lines = []
    scaled = observed.directions[:, observed.kept] / prior[:, None]
    for name, part in _KINDS:
        # The directions kept span a space; what of it lies in this triple shows in its own principal axes.
        U, s, _ = np.linalg.svd(scaled[part])
        for k in np.flatnonzero(s[: len(U)] > np.sqrt(_CAUSE_SHARE)):
            v = U[:, k] * np.sign(U[np.argmax(np.abs(U[:, k])), k])
            axis = ", ".join(f"{x:+.2f}" for x in v)
            lines.append(f"{name} ({axis}): not excited, kept at its prior; {_REMEDIES[name]}")
    for row, name in zip(scaled[6:], AXES[6:], strict=True):
        if float((row**2).sum()) > _CAUSE_SHARE:
            lines.append(f"{name}: not excited, kept at its prior; {_REMEDIES[name]}")
    return tuple(lines)


def difference(T_before: Array, T_after: Array) -> Array:
    """Return rotation about [rad] and shift along [m] imu axes that lead from one mounting to another, (6,)."""
    turn = so3.log(T_after[:3, :3] @ T_before[:3, :3].T)
    return np.concatenate([turn, T_after[:3, 3] - T_before[:3, 3]])
