"""Fixes as they come: those that cannot be used are set aside with the reason, the others become antenna positions."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array, Stamps
from heliograph.config import GnssConfig
from heliograph.data import Event, GnssFix
from heliograph.geodesy import geodetic_to_enu
from heliograph.snapshots import Stateful, array, fixed

__all__ = ["FixIntake"]

_UNREPORTED = 4.0  # floors that a fix without a covariance is given
_VERTICAL = 1.5  # a height is this much worse than a horizontal coordinate
_FAR = 200_000.0  # fixes farther from the first are of another place, or of another datum [m]
_HIGHEST, _DEEPEST = 20_000.0, -12_000.0  # [m]


class FixIntake(Stateful):
    """Collects the fixes of a run about an origin at the first that can be used.

    Parameters
    ----------
    config : GnssConfig
    """

    _STATE: ClassVar = {
        "fixes": [GnssFix],
        "refused": [str],
        "origin": (array(np.float64, 3), None),
        "_stamps": [int],
        "_p": [array(np.float64, 3)],
        "_P": [array(np.float64, 3, 3)],
        "_last": (fixed(float, float, float), None),
    }

    def __init__(self, config: GnssConfig) -> None:
        self._config = config
        self.fixes: list[GnssFix] = []
        self.refused: list[str] = []  # why a fix cannot be used, "" where it can
        self.origin: Array | None = None
        self._stamps: list[int] = []
        self._p: list[Array] = []
        self._P: list[Array] = []
        self._last: tuple[float, float, float] | None = None

    def __len__(self) -> int:
        return len(self.fixes)

    @property
    def stamps_ns(self) -> Stamps:
        """Stamps of all fixes, (N,) [ns]."""
        return np.array(self._stamps, dtype=np.int64)

    @property
    def usable(self) -> Array:
        """Numbers (M,) of the fixes that can be used, ascending."""
        return np.array([k for k, reason in enumerate(self.refused) if not reason], dtype=np.int64)

    def positions(self) -> tuple[Array, Array]:
        """Return positions (N, 3) [m] and covariances (N, 3, 3) [m^2], east-north-up; NaN where there is none."""
        if not self.fixes:
            return np.zeros((0, 3)), np.zeros((0, 3, 3))
        return np.stack(self._p), np.stack(self._P)

    def add(self, fix: GnssFix) -> None:
        """Take the next fix."""
        reason = self._reason(fix)
        geodetic = np.array([*np.radians([fix.latitude_deg, fix.longitude_deg]), fix.altitude])
        p, P = np.full(3, np.nan), np.full((3, 3), np.nan)
        if not reason:
            if self.origin is None:
                self.origin = geodetic
            p = geodetic_to_enu(geodetic[None], self.origin)[0]
            P = self._covariance(fix)
            if float(np.linalg.norm(p)) > _FAR:
                reason = f"{1e-3 * float(np.linalg.norm(p)):.0f} km from the first fix"
                p, P = np.full(3, np.nan), np.full((3, 3), np.nan)
        self.fixes.append(fix)
        self.refused.append(reason)
        self._stamps.append(fix.stamp_ns)
        self._p.append(p)
        self._P.append(P)

    def events(self) -> list[Event]:
        """Return what a user should know of the fixes that cannot be used, one line a reason."""
        texts = {
            "at latitude 0, longitude 0": "gnss-null",
            "not finite": "gnss-bad",
            "out of range": "gnss-bad",
            "repeats the fix before it": "gnss-frozen",
            "km from the first fix": "gnss-far",
        }
        found = []
        for text, code in texts.items():
            where = [k for k, reason in enumerate(self.refused) if text in reason]
            if len(where) > (5 if code == "gnss-frozen" else 0):
                message = f"gnss: {len(where)} of {len(self)} fixes are left out: {self.refused[where[0]]}"
                found.append(Event(code=code, message=message, stamp_ns=self._stamps[where[0]], count=len(where)))
        without = sum(
            not reason and fix.covariance_enu is None for fix, reason in zip(self.fixes, self.refused, strict=True)
        )
        if without:
            sigma = _UNREPORTED * self._config.floor(self.fixes[int(self.usable[0])].solution)
            message = (
                f"gnss: {without} fixes come without a covariance; {sigma:.1f} m is taken (--set gnss.floor_single=...)"
            )
            found.append(Event(code="gnss-no-covariance", message=message, severity="info", count=without))
        return found

    def _reason(self, fix: GnssFix) -> str:
        values = (fix.latitude_deg, fix.longitude_deg, fix.altitude)
        if not fix.valid:
            return "the receiver reports no fix"
        if not all(map(math.isfinite, values)):
            return "its position is not finite"
        if values[0] == 0.0 and values[1] == 0.0:
            return "it is at latitude 0, longitude 0: a receiver without a fix"
        if abs(values[0]) > 90.0 or abs(values[1]) > 360.0 or not _DEEPEST < values[2] < _HIGHEST:
            return f"it is out of range: latitude {values[0]:.3f}, longitude {values[1]:.3f}, height {values[2]:.0f} m"
        if values == self._last:
            return "it repeats the fix before it to the last digit: a frozen receiver, or one faster than it measures"
        self._last = values
        return ""

    def _covariance(self, fix: GnssFix) -> Array:
        """Return the reported covariance with its eigenvalues lifted to the floor; a default where there is none."""
        floor = self._config.floor(fix.solution) * np.array([1.0, 1.0, _VERTICAL])
        P = fix.covariance_enu
        if P is None or not np.isfinite(P).all() or not (np.diag(P) > 0.0).all():
            return np.diag((_UNREPORTED * floor) ** 2)
        scaled = 0.5 * (P + P.T) / floor / floor[:, None]
        values, vectors = np.linalg.eigh(scaled)
        return np.asarray((vectors * np.maximum(values, 1.0)) @ vectors.T * floor * floor[:, None])
