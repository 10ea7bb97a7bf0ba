"""From a scenario and a seed to sensor records in causal order, with the exact truth beside them."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.data import GnssFix, ImuBatch, ImuClock, ImuNoise, Rig, Scan
from heliograph.lie import se3, so3
from heliograph.sim.movers import cast_with_movers
from heliograph.sim.places import PLACES
from heliograph.sim.receiver import ReceiverLog
from heliograph.sim.scenario import Mount, Scenario
from heliograph.sim.sensors import ImuErrors, measure_ranges
from heliograph.sim.trajectory import SimulatedMotion, WalkedPath
from heliograph.sim.wheels import SpeedLog

__all__ = ["EPOCH_NS", "GRAVITY", "SimulatedMounting", "Simulation", "Sweep", "Truth", "simulate"]

EPOCH_NS = 1_750_000_000_000_000_000  # the recording's first instant; any date will do, this one is in June 2025
GRAVITY = 9.80665
_LIDAR_PHASE_NS = 13_700_000  # sweeps do not start at IMU samples, as between two free-running sensors
_GNSS_PHASE_NS = 41_000_000
_WHEEL_PHASE_NS = 3_000_000
_STREAMS = ("world", "mount", "lidar", "imu", "gnss", "wheels")  # new ones behind the others: those keep their numbers
_INTENSITY_SCALE = 255.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedMounting:
    """Where the sensors sit on the walking body, whose origin is the IMU's.

    Parameters
    ----------
    R_body_imu : (3, 3) float64
        Orientation of the IMU.
    T_body_lidar : (4, 4) float64
        Pose of the LiDAR [m].
    """

    R_body_imu: NDArray[np.float64]
    T_body_lidar: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def T_imu_lidar(self) -> NDArray[np.float64]:
        """Pose of the LiDAR in the IMU frame [m]."""
        T_imu_body = se3.from_rotation_translation(self.R_body_imu.T, np.zeros(3))
        return se3.compose(T_imu_body, self.T_body_lidar)

    @classmethod
    def draw(cls, mount: Mount, rng: np.random.Generator) -> SimulatedMounting:
        """Draw lever arm and rotation within the mount's ranges."""
        arm, axis = rng.standard_normal((2, 3))
        arm *= rng.uniform(*mount.lever_arm) / np.linalg.norm(arm)
        angle = np.radians(rng.uniform(*mount.rotation_deg))
        R_rig_lidar = so3.exp(angle * axis / np.linalg.norm(axis))
        R_body_rig = so3.from_rpy(*np.radians(mount.rig_rpy_deg))
        R_body_imu = R_body_rig @ so3.from_rpy(*np.radians(mount.imu_rpy_deg))
        return cls(
            R_body_imu=R_body_imu,
            T_body_lidar=se3.from_rotation_translation(R_body_rig @ R_rig_lidar, R_body_rig @ arm),
        )


class Truth:
    """The exact motion at any instant of a simulated recording.

    Parameters
    ----------
    path : WalkedPath
        Motion of the walking body.
    mounting : SimulatedMounting
        Where the sensors sit on it.
    begin : float
        Time on the path at the recording's first instant [s].
    """

    def __init__(self, path: WalkedPath, mounting: SimulatedMounting, begin: float) -> None:
        self._path, self._mounting, self._begin = path, mounting, begin

    def motion(self, stamps_ns: NDArray[np.int64]) -> SimulatedMotion:
        """Return the IMU's motion: world pose, velocity, acceleration, and body rate in IMU axes."""
        seconds = (np.atleast_1d(stamps_ns) - EPOCH_NS).astype(np.float64) * 1e-9
        body = self._path(seconds + self._begin)
        R_body_imu = self._mounting.R_body_imu
        return SimulatedMotion(
            R_world_body=body.R_world_body @ R_body_imu,
            p_world=body.p_world,
            v_world=body.v_world,
            a_world=body.a_world,
            omega_body=body.omega_body @ R_body_imu,
        )

    def pose(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return T_world_imu, (M, 4, 4)."""
        return self.motion(stamps_ns).T_world_body

    def lidar_pose(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return T_world_lidar, (M, 4, 4)."""
        return se3.compose(self.pose(stamps_ns), self._mounting.T_imu_lidar)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """One turn of the LiDAR as a full image, lost returns included; arrays are (beams, columns).

    Parameters
    ----------
    stamp_ns : int
        Start of the turn [ns].
    end_ns : int
        Start of the next; the driver sends the message then [ns].
    points : (beams, columns, 3) float32
        In the lidar frame at each column's own instant, zero where there is no return [m].
    ranges : float32
        Measured range, 0 where there is no return [m].
    intensity : float32
        0 to 255.
    offsets_ns : (columns,) int32
        Firing time of each column since ``stamp_ns`` [ns].
    """

    stamp_ns: int
    end_ns: int
    points: NDArray[np.float32]
    ranges: NDArray[np.float32]
    intensity: NDArray[np.float32]
    offsets_ns: NDArray[np.int32]

    def __post_init__(self) -> None:
        freeze(self)

    def scan(self, *, point_times: bool = True) -> Scan:
        """Return the sweep as the readers would give it: valid points only, row by row."""
        rows, columns = np.nonzero(self.ranges > 0.0)
        offsets = self.offsets_ns[columns]
        last = int(offsets.max(initial=0)) if point_times else 0
        return Scan(
            stamp_ns=self.stamp_ns,
            header_stamp_ns=self.stamp_ns,
            received_ns=self.end_ns,
            end_ns=self.stamp_ns + last,
            points=self.points[rows, columns],
            offsets_ns=offsets if point_times else np.zeros_like(offsets),
            intensity=self.intensity[rows, columns],
            ring=rows.astype(np.uint16),
            has_point_times=point_times,
        )


class Simulation:
    """A scenario with a seed: iterate over it for records in causal order, as often as wanted.

    Parameters
    ----------
    scenario : Scenario
        What to simulate.
    seed : int
        World, mounting, biases and noise all follow from it.
    threads : int
        For ray casting; the records do not depend on it.
    """

    def __init__(self, scenario: Scenario, seed: int, *, threads: int = 1) -> None:
        self.scenario, self.seed, self._threads = scenario, seed, threads
        self._streams = dict(zip(_STREAMS, np.random.SeedSequence(seed).spawn(len(_STREAMS)), strict=True))
        place = PLACES[scenario.place](self._rng("world"))
        walk = scenario.walk
        path = WalkedPath(place.course, scenario.gait, rest=walk.rest, ramp=walk.ramp, speed=walk.speed)
        self.world, self.movers = place.world, place.movers
        self.mounting = SimulatedMounting.draw(scenario.mount, self._rng("mount"))
        self.truth = Truth(path, self.mounting, walk.begin)
        whole = path.profile.stop + walk.after - walk.begin
        self.duration_ns = round((min(walk.duration, whole) if walk.duration > 0.0 else whole) * 1e9)
        step = round(1e9 / scenario.imu.rate)
        self.imu_stamps_ns = EPOCH_NS + np.arange(0, self.duration_ns + 1, step, dtype=np.int64)
        self.imu_errors = ImuErrors.draw(scenario.imu, len(self.imu_stamps_ns), self._rng("imu"))

    def _rng(self, stream: str) -> np.random.Generator:
        return np.random.default_rng(self._streams[stream])

    @property
    def clock(self) -> ImuClock:
        """How the stamps on the IMU's samples are off."""
        imu = self.scenario.imu
        return ImuClock(offset=imu.clock_offset, drift=1e-6 * imu.clock_drift_ppm, reference_ns=EPOCH_NS)

    @property
    def imu_clock_ns(self) -> NDArray[np.int64]:
        """The stamps that the IMU's samples carry; they were taken at ``imu_stamps_ns`` [ns]."""
        return self.clock.imu_time(self.imu_stamps_ns)

    @property
    def rig(self) -> Rig:
        """The true mounting and the true clock."""
        return Rig(
            T_imu_lidar=self.mounting.T_imu_lidar,
            source="simulation",
            clock=self.clock,
            antenna_imu=self.mounting.R_body_imu.T @ np.array(self.scenario.gnss.antenna),
        )

    @property
    def imu_noise(self) -> ImuNoise:
        """The densities that the IMU samples were drawn with."""
        imu = self.scenario.imu
        return ImuNoise(gyro=imu.gyro_noise, accel=imu.accel_noise, gyro_walk=imu.gyro_walk, accel_walk=imu.accel_walk)

    def sweep_count(self) -> int:
        """Return the number of complete turns in the recording."""
        return max(0, (self.duration_ns - _LIDAR_PHASE_NS) // self.scenario.lidar.period_ns)

    def imu(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return all gyroscope [rad/s] and accelerometer [m/s^2] samples, each (M, 3), of ``imu_stamps_ns``."""
        motion = self.truth.motion(self.imu_stamps_ns)
        up = motion.a_world + np.array([0.0, 0.0, GRAVITY])
        force = np.einsum("mji,mj->mi", motion.R_world_body, up)
        errors = self.imu_errors
        gyro = motion.omega_body + errors.gyro_bias + errors.gyro_noise
        return gyro, force + errors.accel_bias + errors.accel_noise

    def sweeps(self) -> Iterator[Sweep]:
        """Yield the LiDAR's turns, lost returns included."""
        lidar, rng = self.scenario.lidar, self._rng("lidar")
        directions = lidar.directions()
        offsets = lidar.column_offsets_ns
        for k in range(self.sweep_count()):
            stamp = EPOCH_NS + _LIDAR_PHASE_NS + k * lidar.period_ns
            exact = cast_with_movers(
                self.world,
                self.movers,
                directions,
                self.truth.lidar_pose(stamp + offsets),
                np.asarray((stamp - EPOCH_NS + offsets) * 1e-9, dtype=np.float64),
                min_range=lidar.min_range,
                max_range=lidar.max_range,
                threads=self._threads,
            )
            ranges = measure_ranges(exact, lidar, rng)
            yield Sweep(
                stamp_ns=stamp,
                end_ns=stamp + lidar.period_ns,
                points=(directions * ranges[..., None]).astype(np.float32),
                ranges=ranges.astype(np.float32),
                intensity=np.where(ranges > 0.0, _INTENSITY_SCALE * exact.brightness, 0.0).astype(np.float32),
                offsets_ns=offsets.astype(np.int32),
            )

    def fixes(self) -> Iterator[GnssFix]:
        """Yield the GNSS fixes as a recorder gets them; they are invalid where something is above the antenna."""
        yield from self.receiver().fixes()

    def receiver(self) -> ReceiverLog:
        """Return all that the receiver measured, with what was wrong with it."""
        gnss, rng = self.scenario.gnss, self._rng("gnss")
        step = round(1e9 / gnss.rate) if gnss.rate > 0.0 else self.duration_ns + 1
        stamps = EPOCH_NS + np.arange(_GNSS_PHASE_NS, self.duration_ns, step, dtype=np.int64)
        stamps = stamps if gnss.rate > 0.0 else stamps[:0]
        T_imu_body = se3.inverse(se3.from_rotation_translation(self.mounting.R_body_imu, np.zeros(3)))
        antenna = self.truth.pose(stamps) @ T_imu_body @ np.append(gnss.antenna, 1.0)
        T_world_sky = np.tile(np.eye(4), (len(stamps), 1, 1))
        T_world_sky[:, :3, 3] = antenna[:, :3]
        zenith = np.tile([0.0, 0.0, 1.0], (1, len(stamps), 1))
        above = self.world.cast(zenith, T_world_sky, min_range=0.1, max_range=200.0).primitive
        covered = above[0] >= 0 if len(stamps) else np.zeros(0, dtype=bool)
        return ReceiverLog.draw(gnss, stamps, antenna[:, :3], covered, rng)

    def wheels(self) -> SpeedLog:
        """Return what wheels or legs measured."""
        model = self.scenario.wheels
        step = round(1e9 / model.rate) if model.rate > 0.0 else self.duration_ns + 1
        stamps = EPOCH_NS + np.arange(_WHEEL_PHASE_NS, self.duration_ns, step, dtype=np.int64)
        stamps = stamps if model.rate > 0.0 else stamps[:0]
        motion = self.truth.motion(stamps)
        R_world_body = motion.R_world_body @ self.mounting.R_body_imu.T
        v_body = np.einsum("nji,nj->ni", R_world_body, motion.v_world)
        return SpeedLog.draw(model, stamps, v_body, self._rng("wheels"))

    def __iter__(self) -> Iterator[Scan | ImuBatch | GnssFix]:
        """Yield records in the order in which a recorder would have got them."""
        scans = (sweep.scan(point_times=self.scenario.point_times) for sweep in self.sweeps())
        streams: tuple[Iterator[Scan | ImuBatch | GnssFix], ...] = (self._batches(), self.fixes(), scans)
        yield from heapq.merge(*streams, key=lambda record: record.received_ns)

    def _batches(self) -> Iterator[ImuBatch]:
        """Yield the IMU samples in batches that end with the LiDAR's turns, so that none waits for a later scan."""
        gyro, accel = self.imu()
        ends = EPOCH_NS + _LIDAR_PHASE_NS + self.scenario.lidar.period_ns * np.arange(1, self.sweep_count() + 1)
        cuts = np.searchsorted(self.imu_stamps_ns, ends, side="right")
        stamps = self.imu_clock_ns
        for begin, end in pairwise(np.unique([0, *cuts, len(gyro)]).tolist()):
            yield ImuBatch(
                stamps_ns=stamps[begin:end],
                gyro=gyro[begin:end],
                accel=accel[begin:end],
                received_ns=int(self.imu_stamps_ns[end - 1]),
            )


def simulate(scenario: Scenario, seed: int, *, threads: int = 1) -> Simulation:
    """Return a `Simulation`: an iterable of Scan, ImuBatch and GnssFix records with ``.truth`` and ``.rig``.

    Parameters
    ----------
    scenario : Scenario
        E.g. ``SCENARIOS["warehouse"].thinned(beams=16, columns=256, duration=10.0)``.
    seed : int
        Everything random follows from it; the same seed gives the same bits.
    threads : int
        For ray casting; the records do not depend on it.
    """
    return Simulation(scenario, seed, threads=threads)
