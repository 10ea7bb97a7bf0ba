"""Where a simulated body truly was at the stamps of scans, each asked of the simulation once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from heliograph.sim import Simulation

__all__ = ["TrueWay"]


class TrueWay:
    """The true poses of a simulation; a picture of a growing way asks for all of them after every scan.

    Parameters
    ----------
    simulation : Simulation
    """

    def __init__(self, simulation: Simulation) -> None:
        self._truth = simulation.truth
        self._known: dict[int, NDArray[np.float64]] = {}

    def poses(self, stamps_ns: Sequence[int]) -> NDArray[np.float64]:
        """Return T_world_imu at stamps, (N, 4, 4) [m]."""
        new = [stamp for stamp in dict.fromkeys(stamps_ns) if stamp not in self._known]
        if new:
            self._known.update(zip(new, self._truth.pose(np.array(new, dtype=np.int64)), strict=True))
        return np.array([self._known[stamp] for stamp in stamps_ns]).reshape(-1, 4, 4)
