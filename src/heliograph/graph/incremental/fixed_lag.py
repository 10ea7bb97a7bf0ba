"""Smoothing over the last stretch of time only, in bounded memory."""

from __future__ import annotations

import heapq
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array
from heliograph.errors import GraphError
from heliograph.graph.incremental.isam2 import ISAM2
from heliograph.graph.incremental.settings import ISAM2Settings, OutlierRejection
from heliograph.graph.incremental.update_result import UpdateResult
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import Value
from heliograph.graph.model.records import as_keys
from heliograph.graph.model.values import Values

__all__ = ["FixedLagSmoother"]


class FixedLagSmoother:
    """An `ISAM2` that marginalises out what is older than a lag.

    Parameters
    ----------
    lag : float
        Variables older than the newest stamp by more than this leave. Positive, in the unit of the stamps
        (say seconds).
    settings : ISAM2Settings, optional
        Thresholds.
    outliers : OutlierRejection, optional
        As `ISAM2` takes it. What is let go when one of its variables leaves is gone for good, and what counts then is
        part of the summary for good.

    Raises
    ------
    GraphError
        The lag is not positive.

    Notes
    -----
    A variable without a stamp, and one that is held, stays for good. What leaves is summarised as `ISAM2.marginalize`
    says: linear at its neighbours' linearisation points, which then stay. On a linear graph the kept estimates and
    covariances are those of the smoother that keeps everything.
    """

    def __init__(
        self, lag: float, settings: ISAM2Settings | None = None, *, outliers: OutlierRejection | None = None
    ) -> None:
        if not lag > 0.0:
            raise GraphError(f"lag={lag}: must be positive, in the unit of the stamps")
        self.lag = float(lag)
        self.smoother = ISAM2(settings, outliers=outliers)
        self._stamps: dict[int, float] = {}
        self._oldest: list[tuple[float, int]] = []  # heap of (stamp, key); outdated entries are passed over
        self._newest = -np.inf

    def update(
        self,
        graph: FactorGraph | None = None,
        values: Values | None = None,
        stamps: Mapping[int, float] | tuple[ArrayLike, ArrayLike] | None = None,
        *,
        remove: ArrayLike = (),
        remove_variables: ArrayLike = (),
        iterate: float | None = None,
        max_variables: int | None = None,
        trusted: ArrayLike | None = None,
    ) -> UpdateResult:
        """Update as `ISAM2.update` does, then marginalise out what has become too old.

        Parameters
        ----------
        graph, values
            New factors and variables.
        stamps : mapping of key to time, or (keys, times), optional
            Stamps of new variables, or later ones of variables that are to be kept longer. Finite.
        remove, remove_variables, iterate, max_variables, trusted
            As `ISAM2.update` takes them. While variables wait to be eliminated nothing is marginalised out.

        Raises
        ------
        GraphError
            A stamp is not finite or is of an unknown key, or as `ISAM2.update` says. Nothing has changed.
        """
        times = self._checked(stamps, values)
        result = self.smoother.update(
            graph,
            values,
            remove=remove,
            remove_variables=remove_variables,
            iterate=iterate,
            max_variables=max_variables,
            trusted=trusted,
        )
        for key in as_keys(remove_variables).reshape(-1).tolist():
            self._stamps.pop(key, None)
        for key, time in times.items():
            if self.smoother._state.held(key):
                continue
            self._stamps[key] = time
            heapq.heappush(self._oldest, (time, key))
            self._newest = max(self._newest, time)
        old = [] if self.smoother._state.native.waiting else self._too_old()
        if old:
            self.smoother.marginalize(np.array(old, dtype=np.int64))
        return result

    def _checked(
        self, stamps: Mapping[int, float] | tuple[ArrayLike, ArrayLike] | None, values: Values | None
    ) -> dict[int, float]:
        if stamps is None:
            return {}
        if isinstance(stamps, Mapping):
            times = {int(key): float(time) for key, time in stamps.items()}
        else:
            keys, of = as_keys(stamps[0]).reshape(-1), np.asarray(stamps[1], dtype=np.float64).reshape(-1)
            if len(keys) != len(of):
                raise GraphError(f"stamps: {len(of)} times for {len(keys)} keys; give one each")
            times = dict(zip(keys.tolist(), of.tolist(), strict=True))
        for key, time in times.items():
            if not np.isfinite(time):
                raise GraphError(f"key {key}: its stamp is {time}; a stamp must be finite")
            if (values is None or key not in values) and key not in self.smoother:
                raise GraphError(f"key {key}: has a stamp, but is no variable; insert a value for it")
        return times

    def _too_old(self) -> list[int]:
        old = []
        while self._oldest and self._oldest[0][0] < self._newest - self.lag:
            time, key = heapq.heappop(self._oldest)
            if self._stamps.get(key) == time:
                del self._stamps[key]
                old.append(key)
        return old

    @property
    def stamps(self) -> dict[int, float]:
        """Stamps of the variables that can leave, by key."""
        return dict(self._stamps)

    @property
    def bytes(self) -> int:
        """Memory of the tree and its factors."""
        return self.smoother.bytes

    def estimate(self, keys: ArrayLike | None = None) -> Value:
        """Return the estimate, as `ISAM2.estimate`."""
        return self.smoother.estimate(keys)

    def covariance(self, keys: ArrayLike) -> Array:
        """Return covariances, as `ISAM2.covariance`."""
        return self.smoother.covariance(keys)

    def joint(self, keys: ArrayLike) -> Array:
        """Return a joint covariance, as `ISAM2.joint`."""
        return self.smoother.joint(keys)
