"""The checks of an IMU inside a run: its samples against the poses that the run itself came to, on windows."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.checks.evidence import gather
from heliograph.checks.imu import IN_RUN_CHECKS
from heliograph.checks.records import VERDICTS, CheckedMotion, Finding, ImuRecord
from heliograph.config import CheckConfig
from heliograph.data import ImuBatch, Rig, ScanResult, Trajectory
from heliograph.snapshots import Stateful, array

__all__ = ["InertialWatch", "merged"]

_FIRST_S, _WINDOW_S, _PAUSE_S = 12.0, 30.0, 300.0  # the first window, later ones, and what lies between those
_SHORTEST_S = 5.0  # window at a recording's end that is worth a look
_MIN_SCANS, _MATCHED_SHARE = 30, 0.8


class InertialWatch(Stateful):
    """Keeps the samples and poses of one window at a time, and what the checks said of those before.

    The poses are the filter's, so the IMU has a part in them; but thousands of points outvote it, and what it predicts
    wrongly in every scan shows all the same. Where they do not, scans go unmatched, which is told elsewhere.

    Parameters
    ----------
    config : CheckConfig
        From where on a finding warns or fails.
    """

    _STATE: ClassVar = {
        "windows": [[Finding]],
        "_imu": [ImuBatch],
        "_stamps": [int],
        "_poses": [array(np.float64, 4, 4)],
        "_matched": [bool],
        "_mounting": array(np.float64, 4, 4),
        "_begin_ns": (int, None),
    }

    def __init__(self, config: CheckConfig) -> None:
        self.windows: list[tuple[Finding, ...]] = []
        self._config = config
        self._imu: list[ImuBatch] = []
        self._stamps: list[int] = []
        self._poses: list[Array] = []
        self._matched: list[bool] = []
        self._mounting = np.eye(4)
        self._begin_ns: int | None = None

    def observe(self, batch: ImuBatch) -> None:
        """Take in samples."""
        if self._begin_ns is None or batch.stamps_ns[-1] >= self._begin_ns - 1_000_000_000:
            self._imu.append(batch)

    def add(self, result: ScanResult) -> bool:
        """Take in a result; True when it ended a window."""
        if self._begin_ns is None:
            self._begin_ns = result.end_ns
        if result.end_ns < self._begin_ns:
            return False
        self._stamps.append(result.end_ns)
        self._poses.append(result.T_odom_imu @ result.T_imu_lidar)
        self._matched.append(result.matched)
        self._mounting = result.T_imu_lidar
        length = _FIRST_S if not self.windows else _WINDOW_S
        if (result.end_ns - self._begin_ns) * 1e-9 < length:
            return False
        pause = 0.0 if len(self.windows) == 0 else _PAUSE_S
        self._judge()
        self._begin_ns = result.end_ns + round(1e9 * pause)
        return True

    def close(self) -> None:
        """Look at the window that the recording's end cut off."""
        if self._stamps and (self._stamps[-1] - self._stamps[0]) * 1e-9 >= _SHORTEST_S:
            self._judge()

    def _judge(self) -> None:
        if self._imu and len(self._stamps) >= _MIN_SCANS:
            matched = np.array(self._matched)
            if matched.mean() >= _MATCHED_SHARE:
                self.windows.append(self._findings(matched))
        self._imu, self._stamps, self._poses, self._matched = self._imu[-1:], [], [], []

    def _findings(self, matched: np.ndarray) -> tuple[Finding, ...]:
        whole = ImuBatch.joined(self._imu)
        forward = np.concatenate([[True], np.diff(whole.stamps_ns) > 0])
        imu = ImuRecord(
            stamps_ns=whole.stamps_ns[forward],
            received_ns=whole.stamps_ns[forward],
            gyro=whole.gyro[forward],
            accel=whole.accel[forward],
        )
        stamps = np.array(self._stamps, dtype=np.int64)
        ahead = np.concatenate([[True], np.diff(stamps) > 0])
        trajectory = Trajectory(stamps_ns=stamps[ahead], T_frame_body=np.stack(self._poses)[ahead], body="lidar")
        rig = Rig(T_imu_lidar=self._mounting, source="the mounting")
        evidence = gather(
            imu, CheckedMotion(trajectory=trajectory, tracked=matched[ahead], rig=rig), config=self._config
        )
        return tuple(check(evidence) for check in IN_RUN_CHECKS)


def merged(windows: list[tuple[Finding, ...]]) -> tuple[Finding, ...]:
    """Return one finding a check over all windows: the worst that at least half of the windows bear out.

    What one window of a long recording alone shows, a stairway or a crowd may have caused.
    """
    found = []
    for alike in zip(*windows, strict=True):
        told = [finding for finding in alike if finding.verdict != "unknown"]
        ranked = sorted(told or alike, key=lambda finding: -VERDICTS.index(finding.verdict))
        found.append(ranked[(len(ranked) - 1) // 2])
    return tuple(found)
