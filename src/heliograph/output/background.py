"""The output map, filled beside the estimation: its insertions wait for memory, not for the processor."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from heliograph.output.run_folder import MapAccumulator

__all__ = ["BackgroundMap"]

_DEPTH = 2  # scans waiting; each holds its points


class BackgroundMap(MapAccumulator):
    """Inserts scans into another map in one thread, in order, so that the result is the same as without it.

    An insertion's failure is raised by a later call. Reading waits for all insertions.

    Parameters
    ----------
    inner : MapAccumulator
        Used by the thread until something is read.
    """

    def __init__(self, inner: MapAccumulator) -> None:
        self._inner = inner
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="heliograph-map")
        self._pending: deque[Future[None]] = deque()

    def insert(
        self, points_imu: NDArray[np.float32], intensity: NDArray[np.float32] | None, T_map_imu: NDArray[np.float64]
    ) -> None:
        """Queue a scan; wait first where two are queued already."""
        self._wait(_DEPTH - 1)
        self._pending.append(self._thread.submit(self._inner.insert, points_imu, intensity, T_map_imu))

    def points(self) -> NDArray[np.float32]:
        """Return (N, 3) averaged points [m]."""
        self._wait(0)
        return self._inner.points()

    def intensity(self) -> NDArray[np.float32] | None:
        """Return their (N,) mean intensity."""
        self._wait(0)
        return self._inner.intensity()

    def _wait(self, left: int) -> None:
        while len(self._pending) > left:
            self._pending.popleft().result()
