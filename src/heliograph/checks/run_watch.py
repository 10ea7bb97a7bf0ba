"""What the checks look at while a run goes on: its walls, its IMU, its biases; in constant memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.checks.inertial_watch import InertialWatch, merged
from heliograph.checks.records import Finding
from heliograph.checks.surfaces import SurfaceWatch
from heliograph.checks.verdicts import RunEvidence, check_run
from heliograph.config import CheckConfig
from heliograph.data import GraphAccount, ImuBatch, Message, ScanResult, StartAccount
from heliograph.snapshots import PART, Stateful, array

__all__ = ["RunWatch"]

_MAX_BIASES = 64  # noted along the way; of more, every other one is dropped
_SETTLED_SHARE = 0.2  # of the run, after which a bias should have settled

_MIN_JUDGED, _EARLY = 40, 600  # scans before which nothing is judged, and after which a run is too far to begin anew
_DISPUTED_SHARE = 0.3  # of those that found no place, or one that the IMU contradicts
_MENDABLE = frozenset({
    "imu-channels", "accel-unit", "gyro-unit", "clock-offset", "gyro-axes", "accel-axes", "mounting", "lever-arm",
    "imu-prediction",
})  # fmt: skip


class RunWatch(Stateful):
    """Follows a run and gives the six verdicts at its end.

    Parameters
    ----------
    sensors : frozenset of str
        What the run rests on.
    config : CheckConfig
    """

    _STATE: ClassVar = {
        "_inertial": PART,
        "_walls": PART,
        "_biases": [array(np.float64, 6)],
        "_bias_every": int,
        "_seen": int,
        "_degenerate": int,
        "_disputed": int,
        "_pieces": int,
        "_last_bias": array(np.float64, 6),
        "_rms": float,
    }

    def __init__(self, sensors: frozenset[str], config: CheckConfig) -> None:
        self._sensors, self._config = sensors, config
        both = sensors == {"lidar", "imu"}
        self._inertial = InertialWatch(config) if both else None
        self._walls = SurfaceWatch() if "lidar" in sensors else None
        self._biases: list[Array] = []
        self._bias_every = 1
        self._seen = self._degenerate = self._disputed = self._pieces = 0
        self._last_bias = np.full(6, np.nan)
        self._rms = float("nan")

    def observe(self, message: Message) -> None:
        """Take in a message, before the odometry gets it."""
        if self._inertial is not None and isinstance(message, ImuBatch) and len(message):
            self._inertial.observe(message)

    def add(self, result: ScanResult) -> bool:
        """Take in a scan's result; True when a window of the IMU's checks ended with it."""
        if self._walls is not None:
            self._walls.add(result)
        self._last_bias = np.concatenate([result.gyro_bias, result.accel_bias])
        if self._seen % self._bias_every == 0:
            self._biases.append(self._last_bias)
        if len(self._biases) > _MAX_BIASES:
            self._biases, self._bias_every = self._biases[::2], 2 * self._bias_every
        self._seen += 1
        self._degenerate += result.status == "degenerate"
        against = any(event.code == "match-against-imu" for event in result.events)
        self._disputed += against or not result.matched
        self._pieces += any(event.code == "new-piece" for event in result.events)
        if result.matches and np.isfinite(result.rms):
            self._rms = result.rms if not np.isfinite(self._rms) else 0.95 * self._rms + 0.05 * result.rms
        return self._inertial is not None and self._inertial.add(result)

    @property
    def contradicted(self) -> bool:
        """Whether IMU and LiDAR contradict each other, or the map is torn or many scans unplaced by both, early on."""
        if self._inertial is None or not self._seen >= _MIN_JUDGED:
            return False
        if self._seen <= _EARLY and (self._pieces or self._disputed > _DISPUTED_SHARE * self._seen):
            return True
        return len(self._inertial.windows) == 1 and any(
            finding.verdict == "fail" and finding.code in _MENDABLE for finding in self._inertial.windows[0]
        )

    @property
    def inertial(self) -> tuple[Finding, ...]:
        """What the IMU's checks say so far, merged over the windows."""
        return merged(self._inertial.windows) if self._inertial is not None and self._inertial.windows else ()

    def close(self) -> None:
        """Look at what the end of the run cut off."""
        if self._walls is not None:
            self._walls.close()
        if self._inertial is not None:
            self._inertial.close()

    def verdicts(
        self,
        *,
        start: StartAccount | None,
        graph: GraphAccount | None,
        blind: Sequence[tuple[str, float]],
        level_sigma: float,
        distance: float,
        gap: float,
    ) -> tuple[Finding, ...]:
        """Return the six verdicts.

        Parameters
        ----------
        start, graph : StartAccount, GraphAccount or None
        blind : sequence of (str, float)
            Stretches along which one direction was not seen, in words, and what each added to sigma [m].
        level_sigma : float
            One-sigma of the tilt [rad]; NaN where nothing tells which way is up.
        distance, gap : float
            Length of the path, and distance between its ends [m].
        """
        costly = max(blind, key=lambda span: span[1], default=("", 0.0))
        early = self._biases[int(_SETTLED_SHARE * len(self._biases))] if self._biases else self._last_bias
        return check_run(
            RunEvidence(
                walls=tuple(self._walls.windows) if self._walls is not None else (),
                range_sigma=self._rms,
                inertial=self.inertial,
                has_lidar="lidar" in self._sensors,
                has_imu="imu" in self._sensors,
                blind=costly[0],
                blind_growth=costly[1],
                blind_share=self._degenerate / max(self._seen, 1),
                start=start,
                gyro_bias=np.stack([early[:3], self._last_bias[:3]]),
                accel_bias=np.stack([early[3:], self._last_bias[3:]]),
                level_sigma=level_sigma,
                graph=graph,
                distance=distance,
                gap=gap,
                config=self._config,
            )
        )
