"""Wheels and legs that measure speed: scale, noise, slip and impacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, Mask, Stamps, freeze
from heliograph.config_checks import check_range

__all__ = ["SpeedLog", "WheelModel"]

_CLEAR = 0.05  # no slip lies in this share of the recording's beginning and end


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelModel:
    """What measures the body's speed.

    Parameters
    ----------
    rate : float
        Speeds a second [Hz]; 0 leaves it out.
    scale : float
        Metres a measured metre.
    noise : float
        One-sigma of a speed, white [m/s].
    slips, slip_duration, slip_size : int, float, float
        Spells drawn by the seed in which the wheels turn faster than the body moves, by this share; how long [s].
    legs : bool
        Whether sideways and upwards speeds are measured too, with an impact a step: the foot that lands moves.
    impact : float
        One-sigma of the error of a speed at an impact [m/s].
    """

    rate: float = 0.0
    scale: float = 1.0
    noise: float = 0.02
    slips: int = 0
    slip_duration: float = 2.0
    slip_size: float = 0.3
    legs: bool = False
    impact: float = 0.3

    def __post_init__(self) -> None:
        check_range(self, "rate", low=0.0, high=100_000.0)
        check_range(self, "scale", low=-1e3, high=1e3)
        check_range(self, "noise", "impact", "slip_duration", low=0.0, high=1e3)
        check_range(self, "slips", low=0, high=10_000)


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedLog:
    """What was measured, and where the wheels slipped.

    Parameters
    ----------
    stamps_ns : (N,) int64
        [ns].
    v_body : (N, 3) float64
        Forward, left, up [m/s]; NaN in what is not measured.
    slipping : (N,) bool
    """

    stamps_ns: Stamps
    v_body: Array
    slipping: Mask

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def draw(cls, model: WheelModel, stamps_ns: Stamps, v_body: Array, rng: np.random.Generator) -> SpeedLog:
        """Measure true speeds (N, 3) of the body, in its own axes."""
        n = len(stamps_ns)
        measured = v_body / model.scale + model.noise * rng.standard_normal((n, 3))
        seconds = 1e-9 * (stamps_ns - stamps_ns[0]) if n else np.zeros(0)
        slipping = np.zeros(n, dtype=bool)
        length = float(seconds[-1]) if n else 0.0
        first = _CLEAR * length
        last = max(first, (1.0 - _CLEAR) * length - model.slip_duration)
        for start in np.sort(rng.uniform(first, last, model.slips)):
            slipping |= (seconds >= start) & (seconds < start + model.slip_duration)
        measured[slipping, 0] *= 1.0 + model.slip_size
        if model.legs:
            struck = rng.random(n) < 0.1
            measured[struck] += model.impact * rng.standard_normal((int(struck.sum()), 3))
        else:
            measured[:, 1:] = np.nan
        return cls(stamps_ns=stamps_ns, v_body=measured, slipping=slipping)

    def csv(self) -> str:
        """Return the table that `heliograph run --wheels` reads."""
        names = ["vx", "vy", "vz"]
        kept = [k for k in range(3) if len(self.v_body) and np.isfinite(self.v_body[:, k]).all()]
        lines = [",".join(["stamp", *(names[k] for k in kept)])]
        for stamp, row in zip(self.stamps_ns.tolist(), self.v_body[:, kept].tolist(), strict=True):
            lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d}," + ",".join(f"{value:.4f}" for value in row))
        return "\n".join(lines) + "\n"
