"""An odometry beside a driver: messages never wait for it, and poses come at the IMU's rate."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from heliograph.config import ImuConfig
from heliograph.data import Event, ImuBatch, ImuNoise, Message, NavState, Scan, ScanResult
from heliograph.data.error_layout import POSE
from heliograph.imu import predict
from heliograph.odometry.protocol import Odometry

__all__ = ["ImuRatePose", "LiveOdometry"]

_MIN_KEPT_S = 5.0  # of samples, for a result that comes late [s]


class ImuRatePose:
    """The latest result carried on by the samples since: a state at each IMU sample, also while the LiDAR is silent.

    Parameters
    ----------
    config : ImuConfig, optional
        Noise and limits of the IMU; the default is that of a run.
    """

    def __init__(self, config: ImuConfig | None = None) -> None:
        self._config = config if config is not None else ImuConfig()
        c = self._config
        self._noise = ImuNoise(gyro=c.gyro_noise, accel=c.accel_noise, gyro_walk=c.gyro_walk, accel_walk=c.accel_walk)
        self._samples = ImuBatch.joined([])
        self._scan_state: NavState | None = None
        self._state: NavState | None = None

    def add(self, batch: ImuBatch) -> NavState | None:
        """Take samples that follow the ones before; return the state at the last of them, None before the first result.

        Its pose covariance is against the odom frame's origin, and grows with the time since the last scan.
        """
        if len(batch) > 0:
            self._samples = ImuBatch.joined([self._samples, batch])
            if self._scan_state is None:
                self._forget()
            elif self._state is not None:
                self._state = self._carried(self._state)
        return self._state

    def correct(self, result: ScanResult) -> NavState | None:
        """Take a result; return the state at the last sample as the result has it."""
        covariance = result.covariance.copy()
        covariance[POSE, POSE] = result.pose_covariance
        found = result.calibration
        self._scan_state = NavState(
            stamp_ns=result.end_ns,
            R_odom_imu=result.T_odom_imu[:3, :3],
            p_odom=result.T_odom_imu[:3, 3],
            v_odom=result.v_odom,
            gyro_bias=result.gyro_bias,
            accel_bias=result.accel_bias,
            g_odom=result.g_odom,
            T_imu_lidar=result.T_imu_lidar,
            covariance=covariance,
            imu_offset=found.imu_offset if found is not None else 0.0,
            imu_drift=found.imu_drift if found is not None else 0.0,
        )
        self._state = self._carried(self._scan_state)
        self._forget()
        return self._state

    def _carried(self, state: NavState) -> NavState:
        """Return a state at the last sample; the state itself where that is no later."""
        imu = self._samples
        if not state.imu_clock.exact:
            imu = replace(imu, stamps_ns=state.imu_clock.lidar_time(imu.stamps_ns))
        if len(imu) == 0 or int(imu.stamps_ns[-1]) <= state.stamp_ns:
            return state
        first = max(int(np.searchsorted(imu.stamps_ns, state.stamp_ns, side="right")) - 1, 0)
        return predict(state, imu[first:], int(imu.stamps_ns[-1]), noise=self._noise, config=self._config).state

    def _forget(self) -> None:
        """Drop samples that no later result can ask for."""
        if len(self._samples) == 0:
            return
        begin = int(self._samples.stamps_ns[-1]) - round(1e9 * _MIN_KEPT_S)
        if self._scan_state is not None:
            begin = min(begin, self._scan_state.stamp_ns - round(1e9 * abs(self._scan_state.imu_offset)))
        first = max(int(np.searchsorted(self._samples.stamps_ns, begin)) - 1, 0)
        self._samples = self._samples[first:]


class LiveOdometry:
    """Runs an odometry in a thread of its own, so that a driver's callback never waits.

    Inertial samples are never left out. Where scans come faster than they are processed, more than ``max_waiting`` of
    them, the oldest one that waits is left out, and the event ``scans-dropped`` counts them: the latency stays bounded,
    and the odometry carries on over the gap as over any other.

    Parameters
    ----------
    odometry : Odometry
        Not used otherwise as long as this runs.
    on_result : callable
        Called with each `ScanResult`, in the thread of the odometry.
    max_waiting : int
        Scans that may wait.
    imu : ImuConfig, optional
        For `pose`.

    Examples
    --------
    >>> from heliograph.config import RunConfig
    >>> from heliograph.odometry import make_odometry
    >>> from heliograph.sim import SCENARIOS, simulate
    >>> drive = simulate(SCENARIOS["room"].thinned(beams=8, columns=90, duration=2.0), seed=1)
    >>> stamps = []
    >>> odometry = make_odometry(RunConfig(), drive.rig, frozenset({"lidar", "imu"}), 1)
    >>> with LiveOdometry(odometry, on_result=lambda result: stamps.append(result.end_ns), max_waiting=100) as live:
    ...     for message in drive:
    ...         live.add(message)
    >>> len(stamps), live.pose().stamp_ns >= stamps[-1]
    (19, True)
    """

    def __init__(
        self,
        odometry: Odometry,
        *,
        on_result: Callable[[ScanResult], None],
        max_waiting: int = 10,
        imu: ImuConfig | None = None,
    ) -> None:
        self.dropped = 0
        """Scans left out because others waited."""
        self._odometry, self._on_result, self._max_waiting = odometry, on_result, max_waiting
        self._pose, self._pose_lock = ImuRatePose(imu), threading.Lock()
        self._queue: deque[Message] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="heliograph-live", daemon=True)
        self._thread.start()

    def add(self, message: Message) -> None:
        """Take a message and return at once; a failure of the odometry is raised here."""
        if isinstance(message, ImuBatch):
            with self._pose_lock:
                self._pose.add(message)
        with self._changed:
            self._raise()
            self._queue.append(message)
            if self.waiting > self._max_waiting:
                self._drop_oldest()
            self._changed.notify()

    def pose(self) -> NavState | None:
        """Return the state at the latest IMU sample, None before the first result."""
        with self._pose_lock:
            return self._pose.add(ImuBatch.joined([]))

    @property
    def waiting(self) -> int:
        """Scans that wait for the odometry."""
        with self._changed:
            return sum(isinstance(message, Scan) for message in self._queue)

    @property
    def events(self) -> list[Event]:
        """The odometry's events, and how many scans were left out."""
        if self.dropped == 0:
            return list(self._odometry.events)
        text = (
            f"{self.dropped} scans were left out because more than {self._max_waiting} waited; lower "
            f"cloud.target_points, raise the threads, or let more wait"
        )
        return [*self._odometry.events, Event(code="scans-dropped", message=text, count=self.dropped)]

    def close(self) -> None:
        """Process what waits, finish the odometry and end the thread; a failure of it is raised."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()
        self._raise()

    def __enter__(self) -> LiveOdometry:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _drop_oldest(self) -> None:
        oldest = next(message for message in self._queue if isinstance(message, Scan))
        self._queue = deque(message for message in self._queue if message is not oldest)
        self.dropped += 1

    def _raise(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _work(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._queue or self._ended)
                    message = self._queue.popleft() if self._queue else None
                self._give(self._odometry.add(message) if message is not None else self._odometry.finish())
                if message is None:
                    return
        except Exception as error:  # it is the caller's: raised by its next call
            with self._changed:
                self._failure = error
                self._queue.clear()

    def _give(self, results: list[ScanResult]) -> None:
        for result in results:
            with self._pose_lock:
                self._pose.correct(result)
            self._on_result(result)
