"""Whether the filter's covariance is honest: NEES and NIS over many runs.

After Y. Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, section 5.4.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import chi2

from heliograph.config import ImuConfig, RunConfig
from heliograph.data import ImuBatch, NavState
from heliograph.imu import propagate
from heliograph.lie import so3
from heliograph.odometry import make_odometry
from heliograph.odometry.filter.error_state import local, retract
from heliograph.odometry.filter.update import iterated_update
from heliograph.sim import SCENARIOS, simulate
from states import GRAVITY

RUNS, UPDATES, POINTS, SIGMA = 40, 15, 30, 0.03
EXACT = replace(ImuConfig(), curvature=0.0)
WALK = SCENARIOS["room"].thinned(beams=2, columns=8).varied(walk={"begin": 6.0, "duration": 2.0})
START = np.repeat([0.01, 0.03, 0.05, 0.003, 0.05, 0.01], [3, 3, 3, 3, 3, 2])


@dataclass(frozen=True)
class Planes:
    """Point-to-plane measurements of a map that is known exactly, with independent noise."""

    H: np.ndarray
    r: np.ndarray
    columns = np.arange(6)

    @property
    def information(self):
        return self.H.T @ self.H / SIGMA**2

    @property
    def gradient(self):
        return self.H.T @ self.r / SIGMA**2


def true_state(simulation, k):
    motion, errors = simulation.truth.motion(simulation.imu_stamps_ns[k : k + 1]), simulation.imu_errors
    return NavState(
        stamp_ns=int(simulation.imu_stamps_ns[k]),
        R_odom_imu=motion.R_world_body[0],
        p_odom=motion.p_world[0],
        v_odom=motion.v_world[0],
        gyro_bias=errors.gyro_bias[k],
        accel_bias=errors.accel_bias[k],
        g_odom=np.array([0.0, 0.0, -GRAVITY]),
        T_imu_lidar=np.eye(4),
        covariance=np.diag(START**2),
    )


def measured(truth, rng):
    """A measurement of POINTS points of the imu frame on planes through where they truly are, off by noise."""
    points, noise = rng.uniform(-8.0, 8.0, (POINTS, 3)), SIGMA * rng.normal(size=POINTS)
    normals = rng.normal(size=(POINTS, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    at = points @ truth.R_odom_imu.T + truth.p_odom

    def linearize(state, _):
        r = np.sum(normals * (points @ state.R_odom_imu.T + state.p_odom - at), axis=1) + noise
        return Planes(np.hstack([np.cross(points, normals @ state.R_odom_imu), normals]), r)

    return linearize


def filter_run(seed):
    """NEES of the whole state and of the pose at the end, and the NIS of each update."""
    rng, simulation = np.random.default_rng(seed), simulate(WALK, seed)
    gyro, accel = simulation.imu()
    imu = ImuBatch(stamps_ns=simulation.imu_stamps_ns, gyro=gyro, accel=accel, received_ns=0)
    state = retract(true_state(simulation, 0), START * rng.normal(size=17))
    nis = []
    for update in range(1, UPDATES + 1):
        k = 20 * update
        state, _ = propagate(state, imu, int(simulation.imu_stamps_ns[k]), noise=simulation.imu_noise, config=EXACT)
        truth = true_state(simulation, k)
        result = iterated_update(
            state, measured(truth, rng), max_iterations=8, tolerance_rotation=1e-7, tolerance_position=1e-7
        )
        assert result.converged
        state = result.state
        nis.append(result.nis)
    error = local(state, truth)
    parts = [slice(0, 6), slice(0, 15), slice(0, 17)]
    return [error[s] @ np.linalg.solve(state.covariance[s, s], error[s]) for s in parts], nis


@pytest.fixture(scope="module")
def runs():
    return [filter_run(seed) for seed in range(RUNS)]


def band(dof, count):
    """Two-sided 95 % interval of the mean of ``count`` chi-square draws."""
    return chi2.ppf([0.025, 0.975], dof * count) / count


@pytest.mark.parametrize(("part", "dof"), [(0, 6), (1, 15), (2, 17)])
def test_error_fits_the_covariance(runs, part, dof):
    low, high = band(dof, RUNS)
    assert low < np.mean([nees[part] for nees, _ in runs]) < high


def test_corrections_fit_their_prediction(runs):
    low, high = band(6, RUNS * UPDATES)
    assert low < np.mean([nis for _, nis in runs]) < high


def test_nees_notices_a_noise_that_is_half_of_the_truth():
    """The measure itself can fail: an IMU trusted twice too much shows."""
    squares = []
    for seed in range(RUNS):
        simulation = simulate(WALK, seed)
        gyro, accel = simulation.imu()
        imu = ImuBatch(stamps_ns=simulation.imu_stamps_ns, gyro=gyro, accel=accel, received_ns=0)
        truth = replace(true_state(simulation, 0), covariance=np.zeros((17, 17)))
        noise = simulation.imu_noise
        trusted = replace(noise, gyro=noise.gyro / 2.0, accel=noise.accel / 2.0)
        state, _ = propagate(truth, imu, int(simulation.imu_stamps_ns[60]), noise=trusted, config=EXACT)
        error = local(state, true_state(simulation, 60))[:9]
        squares.append(error @ np.linalg.solve(state.covariance[:9, :9], error))
    assert np.mean(squares) > 2.0 * band(9, RUNS)[1]


def pose_nees(seed, place, duration):
    """NEES of the pose against the odom origin at the end of a run of the whole odometry, and that of its parts."""
    simulation = simulate(SCENARIOS[place].thinned(beams=16, columns=256, duration=duration), seed)
    odometry = make_odometry(RunConfig(), simulation.rig, frozenset({"lidar", "imu"}), 1)
    results = [r for record in simulation for r in odometry.add(record)] + odometry.finish()
    first, last = results[0], results[-1]
    truth = simulation.truth.pose(np.array([first.end_ns, last.end_ns]))
    expected = first.T_odom_imu @ np.linalg.inv(truth[0]) @ truth[1]
    turn = so3.log(last.T_odom_imu[:3, :3].T @ expected[:3, :3])
    error = np.concatenate([turn, expected[:3, 3] - last.T_odom_imu[:3, 3]])
    P = last.pose_covariance
    return [
        error @ np.linalg.solve(P, error),
        turn @ np.linalg.solve(P[:3, :3], turn),
        error[3:] @ np.linalg.solve(P[3:, 3:], error[3:]),
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("place", "duration"), [("warehouse", 12.0), ("demo", 20.0), ("room", 15.0)])
def test_odometry_covers_its_drift_and_not_by_orders_of_magnitude(place, duration):
    """Drift is no chi-square variable (all poses share the map's errors), so the gates are wide."""
    nees = np.array([pose_nees(seed, place, duration) for seed in range(1, 9)])
    assert 6.0 / 9.0 < np.median(nees[:, 0]) < 1.5 * 6.0
    assert np.median(nees[:, 2]) < 1.5 * 3.0
    assert nees[:, 0].max() < chi2.ppf(0.999, 6)
