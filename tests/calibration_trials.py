"""Calibrations of simulated sensors with a known truth: from poses alone, which is fast, and from whole recordings."""

from dataclasses import dataclass

import numpy as np

from heliograph.calibration import calibrate
from heliograph.calibration.gather import refined
from heliograph.calibration.observability import difference, prior_sigmas
from heliograph.calibration.rounds import change_from, run_rounds
from heliograph.calibration.states import CalibrationState, LidarPoses, RigPrior
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, ImuClock, Rig
from heliograph.lie import se3, so3
from heliograph.sim import SCENARIOS, simulate

CONFIG = RunConfig()
POSE_SIGMA = np.array([2e-4, 1.5e-4, 1e-4, 1e-3, 0.7e-3, 1.5e-3])  # of the pose-level trials [rad], [m]


@dataclass(frozen=True)
class Trial:
    """The error along what the motion told, its normalised square, and how many numbers that were."""

    error: np.ndarray  # (8,): rotation [rad] and lever arm [m] along imu axes, offset [s], drift [s/s]
    nees: float
    told: int
    kept: np.ndarray  # (8, 8): the projection onto what kept its prior
    result: object


def simulation(scenario, seed, **changes):
    """Return a simulation with a drawn clock, and a mounting that is wrong by up to 5 deg and 0.3 m."""
    rng = np.random.default_rng([7, seed])
    clock = {"clock_offset": rng.uniform(-0.03, 0.03), "clock_drift_ppm": rng.uniform(-50.0, 50.0)}
    chosen = SCENARIOS[scenario].varied(imu=clock, **changes)
    sensors = simulate(chosen, seed)
    turn, shift = rng.standard_normal((2, 3))
    wrong = sensors.rig.T_imu_lidar.copy()
    wrong[:3, :3] = wrong[:3, :3] @ so3.exp(np.radians(5.0) * rng.uniform() * turn / np.linalg.norm(turn))
    wrong[:3, 3] += 0.3 * rng.uniform() * shift / np.linalg.norm(shift)
    return sensors, Rig(T_imu_lidar=wrong, source="wrong")


def judged(sensors, found, observed, result):
    """Compare a mounting and a clock with the truth."""
    middle = np.int64(found.clock.reference_ns)
    clock = sensors.clock
    error = np.concatenate(
        [
            difference(found.T_imu_lidar, sensors.rig.T_imu_lidar),
            [float(clock.offset_at(middle)) - found.clock.offset, clock.drift - found.clock.drift],
        ]
    )
    parts = np.linalg.inv(observed.directions) @ error
    seen = ~observed.kept
    nees = float(np.sum(parts[seen] ** 2 * (1.0 + observed.gains[seen] ** 2)))
    kept = observed.directions[:, observed.kept] @ np.linalg.inv(observed.directions)[observed.kept]
    return Trial(error=observed.observed_part(error), nees=nees, told=int(seen.sum()), kept=kept, result=result)


def recording_trial(scenario, seed, *, config=CONFIG, **changes):
    """Calibrate a whole recording."""
    sensors, wrong = simulation(scenario, seed, **changes)
    result = calibrate(iter(sensors), wrong, config)
    return judged(sensors, result.rig, result.observed, result)


def pose_trial(scenario, seed, *, period_ns=100_000_000, config=CONFIG, **changes):
    """Calibrate from exact poses with white noise of a known size, which the calibration is not told."""
    sensors, wrong = simulation(scenario, seed, **changes)
    rng = np.random.default_rng([8, seed])
    count = (sensors.duration_ns - 160_000_000) // period_ns
    stamps = sensors.imu_stamps_ns[0] + 80_000_000 + period_ns * np.arange(count)
    T = se3.inverse(sensors.truth.lidar_pose(stamps[:1])) @ sensors.truth.lidar_pose(stamps)
    noisy = T @ se3.exp(POSE_SIGMA * rng.standard_normal((len(T), 6)))
    poses = LidarPoses(stamps_ns=stamps, T_odom_lidar=noisy, covariance=np.tile(1e-6 * np.eye(6), (len(T), 1, 1)))
    gyro, accel = sensors.imu()
    imu = ImuBatch(stamps_ns=sensors.imu_clock_ns, gyro=gyro, accel=accel, received_ns=0)
    prior = RigPrior(
        T_imu_lidar=wrong.T_imu_lidar,
        clock=ImuClock(reference_ns=int(stamps[len(stamps) // 2])),
        information=np.diag(prior_sigmas(config.calibration) ** -2.0),
    )
    up = noisy[0, :3, :3] @ wrong.T_imu_lidar[:3, :3].T @ accel[:100].mean(axis=0)
    start = CalibrationState(
        T_imu_lidar=prior.T_imu_lidar, clock=prior.clock, g_odom=-9.80665 * up / np.linalg.norm(up)
    )
    rounds = run_rounds(
        poses,
        lambda _: poses,
        refined(imu),
        noise=sensors.imu_noise,
        config=config,
        prior=prior,
        start=start,
        bias=np.concatenate([gyro[:100].mean(axis=0), np.zeros(3)]),
    )
    change = rounds.observed.observed_part(change_from(prior, rounds.estimate.state))
    found = wrong.T_imu_lidar.copy()
    found[:3, :3] = so3.exp(change[:3]) @ found[:3, :3]
    found[:3, 3] += change[3:6]
    clock = ImuClock(offset=change[6], drift=change[7], reference_ns=prior.clock.reference_ns)
    return judged(sensors, Rig(T_imu_lidar=found, source="trial", clock=clock), rounds.observed, rounds)


def nees_band(total, trials, *, share=0.95):
    """Return the two-sided band of the mean normalised squared error of trials with ``total`` numbers in all."""
    from scipy.stats import chi2

    return tuple(chi2.ppf([(1 - share) / 2, (1 + share) / 2], total) / trials)
