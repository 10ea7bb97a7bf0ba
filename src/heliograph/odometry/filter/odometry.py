"""The filter as an `Odometry`: messages in, results out."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.config import RunConfig
from heliograph.data import (
    Event,
    GnssFix,
    ImuBatch,
    ImuNoise,
    NavState,
    OnlineCalibration,
    Rig,
    Scan,
    ScanResult,
    StartAccount,
    WheelSpeeds,
)
from heliograph.data.error_layout import GRAVITY
from heliograph.errors import DataError
from heliograph.imu.clock_shift import HALF_WINDOW
from heliograph.lie import so3
from heliograph.maps import LocalMap
from heliograph.odometry.filter.calibrating import uncertain_rig, with_calibration
from heliograph.odometry.filter.core import FilterCore
from heliograph.odometry.filter.interlude import Interlude
from heliograph.odometry.filter.motion import MotionModel
from heliograph.odometry.filter.start import FirstLook, find_start, look
from heliograph.odometry.filter.wheels import SpeedUpdates, with_wheel_scale
from heliograph.odometry.sequencer import Packet, Sequencer
from heliograph.snapshots import PART, Snapshot, require

__all__ = ["FilterOdometry", "ScanEstimator"]

# Samples are kept longer than they are needed, by this factor: the next offset may be a smaller one.
_KEEP_FACTOR = 20
_REMARK_TILT_DEG, _WARNING_TILT_DEG = 0.2, 1.0  # sigma of the level that deserves a remark, a warning [deg]

_STATE = {
    "events": [Event],
    "start": (StartAccount, None),
    "noise": (ImuNoise, None),
    "sequencer": PART,
    "waiting": [Packet],
    "core": PART,
}


class ScanEstimator(Protocol):
    """One state that steps from scan to scan, whatever it matches."""

    state: NavState

    def snapshot(self) -> Snapshot:
        """Return what the next scans depend on."""
        ...

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another one that was made alike."""
        ...

    @property
    def calibration(self) -> OnlineCalibration | None:
        """Mounting and clock as they are estimated now, None where they are not."""
        ...

    def process(self, scan: Scan, imu: ImuBatch) -> ScanResult:
        """Process one scan."""
        ...

    def dead_reckon(self, end_ns: int, imu: ImuBatch) -> ScanResult:
        """Carry the state on without one."""
        ...


class FilterOdometry:
    """The filter as an `Odometry`: it gathers a second or three, finds a start, and then steps scan by scan.

    Nothing is lost by the waiting: the first scans are processed like all others once the start is known.

    Parameters
    ----------
    config : RunConfig
    rig : Rig
        Mounting; where it is uncertain, it is estimated along.
    sensors : frozenset of str
        ``"lidar"``, ``"imu"`` or both.
    threads : int
        Threads of the native loops; the results do not depend on them.
    local_map : LocalMap, optional
        What scans are matched to; a `VoxelMap` if not given.
    """

    def __init__(
        self,
        config: RunConfig,
        rig: Rig,
        *,
        sensors: frozenset[str],
        threads: int = 1,
        local_map: LocalMap | None = None,
    ) -> None:
        self.events: list[Event] = []
        self.core: ScanEstimator | None = None
        self.start: StartAccount | None = None
        self.motion: MotionModel | None = None
        """What carries the state from scan to scan, once there is a start."""
        self._config, self._threads, self._local_map = config, threads, local_map
        self._rig = uncertain_rig(rig, config.filter)
        self._sensors = sensors & {"lidar", "imu"}
        self._sequencer = Sequencer(self._sensors, patience_ns=round(1e9 * config.imu.patience))
        self._speeds = SpeedUpdates(config.wheels)
        self._waiting: list[Packet] = []
        self._first: FirstLook | None = None
        self._ended = False
        self._interlude = Interlude(self._sequencer.imu)
        self._around_ns = int(1e9 * HALF_WINDOW) if config.filter.estimate_time_offset else 0

    def add(self, message: Scan | ImuBatch | GnssFix) -> list[ScanResult]:
        """Take one message and return the results that it made ready."""
        return self._advance(self._sequencer.add(message), ended=False)

    def observe_speeds(self, speeds: WheelSpeeds) -> None:
        """Take all speeds of wheels or legs, before the recording begins."""
        self._speeds.observe(speeds)

    def finish(self) -> list[ScanResult]:
        """Return the results still waiting."""
        results = [*self._advance(self._sequencer.finish(), ended=True), *self._interlude.ended(self.core, self._step)]
        if not self._ended:
            self._ended = True
            self.events += [*self._doubts(), *self._calibrated()]
            self.events += self._speeds.conclusion(self.core.state) if self.core is not None else ()
        return results

    @property
    def between(self) -> bool:
        """Whether scans wait for a start, or for a place: until that is found there is no state to go on from."""
        return self.core is None or self._interlude.lasts

    def snapshot(self) -> Snapshot:
        """Return what the next messages' results depend on; not `between`."""
        if self.core is None or self.between:
            raise DataError("an odometry whose scans wait for a start or a place has no state to go on from")
        return {
            "events": self.events,
            "start": self.start,
            "noise": self.motion.noise if self.motion is not None else None,
            "sequencer": self._sequencer.snapshot(),
            "waiting": self._waiting,
            "core": self.core.snapshot(),
        }

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another one that was made with the same arguments."""
        require(self, snapshot, _STATE)
        state, noise = snapshot["core"].get("state"), snapshot["noise"]
        if not isinstance(state, NavState):
            raise DataError("the state of an odometry holds no pose to go on from")
        self.events, self.start, self._waiting = snapshot["events"], snapshot["start"], snapshot["waiting"]
        self._sequencer.restore(snapshot["sequencer"])
        self.motion = MotionModel(self._config.imu, self._config.filter, noise)
        self.core = self._make_core(state, self.motion)
        self.core.restore(snapshot["core"])

    def leveling(self) -> NDArray[np.float64]:
        """Return ``T_leveled_odom`` (4, 4): the smallest rotation that lets the latest gravity point down."""
        T = np.eye(4)
        if self.core is not None and np.linalg.norm(self.core.state.g_odom) > 0.0:
            T[:3, :3] = so3.from_two_vectors(self.core.state.g_odom, np.array([0.0, 0.0, -1.0]))
        return T

    def _doubts(self) -> list[Event]:
        """Return what the last state says about the whole run: how well it knows which way is up."""
        if self.core is None or np.linalg.norm(self.core.state.g_odom) == 0.0:
            return []
        tilt = np.degrees(np.sqrt(float(np.linalg.eigvalsh(self.core.state.covariance[GRAVITY, GRAVITY])[-1])))
        if tilt < _REMARK_TILT_DEG:
            return []
        text = (
            f"up is known to +- {tilt:.2f} deg only: over this recording a tilt cannot be told from an accelerometer "
            f"bias - turn the sensor about its vertical axis to separate them"
        )
        severity = "warning" if tilt >= _WARNING_TILT_DEG else "info"
        return [Event(code="tilt-uncertain", message=text, stamp_ns=self.core.state.stamp_ns, severity=severity)]

    def _calibrated(self) -> list[Event]:
        """Return what was found of mounting and clock."""
        found = self.core.calibration if self.core is not None else None
        if found is None:
            return []
        sigma = found.sigma
        text = (
            f"estimated along: mounting rotation to +- {np.degrees(sigma[:3].max()):.2f} deg, lever arm to "
            f"+- {sigma[3:6].max():.3f} m, clock offset {1e3 * found.imu_offset:.2f} +- {1e3 * sigma[6]:.2f} ms, "
            f"drift {1e6 * found.imu_drift:.1f} +- {1e6 * sigma[7]:.1f} ppm"
        )
        if found.kept_names:
            text += f"; not excited and kept as given: {', '.join(found.kept_names)} - turn about all axes to tell them"
        return [Event(code="online-calibration", message=text, severity="info")]

    def _advance(self, packets: list[Packet], *, ended: bool) -> list[ScanResult]:
        results = []
        # One by one: how many become ready at once depends on how a driver cuts the IMU's samples, the start must not.
        for packet in packets:
            self._waiting.append(packet)
            results += self._release(ended=False)
        if ended:
            results += self._release(ended=True)
        return results

    def _release(self, *, ended: bool) -> list[ScanResult]:
        """Return the results of the packets that wait, once there is a start."""
        if self.core is None and not self._start(ended=ended):
            return []
        packets, self._waiting = self._waiting, []
        results = [result for packet in packets for result in self._interlude.stepped(packet, self.core, self._step)]
        self.events += self._sequencer.events
        self._sequencer.events = []
        return results

    def _start(self, *, ended: bool) -> bool:
        if not self._waiting:
            return False
        first = self._waiting[0]
        begin_ns = first.scan.stamp_ns if first.scan is not None else first.end_ns
        gathered = (self._waiting[-1].end_ns - begin_ns) * 1e-9
        if not ended and gathered < self._config.imu.start_window:
            return False
        imu = self._sequencer.imu.until(self._waiting[-1].end_ns)
        if self._first is None:
            self._first = look(self._waiting, imu, self._rig, self._config, threads=self._threads)
        # What begins in motion is known better from more of it.
        if not ended and self._first.wants_more and gathered < self._config.imu.moving_window:
            return False
        start = find_start(self._waiting, imu, self._rig, self._config, threads=self._threads, first=self._first)
        self.events += start.events
        self.start = start.account
        state = with_calibration(start.state, self._config.filter) if start.motion.inertial else start.state
        if len(self._speeds) and start.motion.inertial:
            state = with_wheel_scale(state, self._config.wheels)
        self.motion = start.motion
        self.core = self._make_core(state, start.motion)
        return True

    def _make_core(self, state: NavState, motion: MotionModel) -> ScanEstimator:
        return FilterCore(
            state, motion, self._config, local_map=self._local_map, speeds=self._speeds, threads=self._threads
        )

    def _step(self, packet: Packet) -> ScanResult:
        assert self.core is not None
        begin_ns, end_ns = self._imu_time(self.core.state.stamp_ns), self._imu_time(packet.end_ns)
        imu = self._sequencer.imu.between(begin_ns - self._around_ns, end_ns + self._around_ns)
        if packet.scan is not None:
            result = self.core.process(packet.scan, imu)
        else:
            result = self.core.dead_reckon(packet.end_ns, imu)
        now_ns = self._imu_time(packet.end_ns)
        if not self._interlude.lasts:
            self._sequencer.imu.forget_before(now_ns - _KEEP_FACTOR * self._around_ns)
        self._sequencer.lead_ns = now_ns - packet.end_ns + self._around_ns
        return result

    def _imu_time(self, lidar_ns: int) -> int:
        """Return what the IMU's clock shows at a stamp of the LiDAR's, as the state has it now [ns]."""
        assert self.core is not None
        return int(self.core.state.imu_clock.imu_time(np.int64(lidar_ns)))
