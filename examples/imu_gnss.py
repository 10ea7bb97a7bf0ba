"""A car with an IMU and satellite fixes, started in motion: python examples/imu_gnss.py."""

import numpy as np

from heliograph.data import ImuBatch, ImuNoise
from heliograph.factors import CombinedImu, LeverArmPosition
from heliograph.graph import FactorGraph, Isotropic, Marginals, Prior, Values, solve
from heliograph.imu import preintegrate, start_from_positions
from heliograph.lie import ExtendedPose, se23

NOISE = ImuNoise(gyro=1e-3, accel=1e-2, gyro_walk=1e-5, accel_walk=1e-4)
ARM, DOWN = np.array([0.3, 0.0, 1.2]), np.array([0.0, 0.0, -9.80665])
SECONDS, RATE = 60, 100


def drive(rng: np.random.Generator) -> tuple[ImuBatch, np.ndarray, ExtendedPose]:
    """Return samples with noise and biases, stamps a second apart, and the truth at them."""
    stamps = np.arange(SECONDS * RATE + 1, dtype=np.int64) * (1_000_000_000 // RATE)
    t = 1e-9 * stamps
    gyro = np.stack([0.02 * np.sin(t), 0.01 * np.cos(2 * t), 0.3 * np.sin(0.3 * t)], axis=1)
    speed_up, turn = 1.5 * np.sin(0.4 * t), 8.0 * gyro[:, 2]
    accel = np.stack([speed_up, turn, np.full_like(t, 9.80665)], axis=1)
    perfect = ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=0)
    first = se23.from_rotation_position_velocity(np.eye(3), [0.0, 0.0, 0.0], [8.0, 0.0, 0.0])
    seconds = stamps[::RATE]
    motion = preintegrate(perfect, np.zeros_like(seconds), seconds, noise=NOISE)
    truth = motion.predict(ExtendedPose(first), np.zeros(3), np.zeros(3), DOWN)
    noisy = [
        signal + bias + density * np.sqrt(RATE) * rng.normal(size=signal.shape)
        for signal, bias, density in ((gyro, 0.004, NOISE.gyro), (accel, 0.05, NOISE.accel))
    ]
    return ImuBatch(stamps_ns=stamps, gyro=noisy[0], accel=noisy[1], received_ns=0), seconds, truth


def main() -> None:
    rng = np.random.default_rng(1)
    imu, stamps, truth = drive(rng)
    antenna = truth.position + np.einsum("nij,j->ni", truth.rotation, ARM)
    fixes = antenna + rng.normal(size=antenna.shape)
    start = start_from_positions(imu, stamps[:10], fixes[:10], sigma=1.0, noise=NOISE).X_world_imu
    motion = preintegrate(imu, stamps[:-1], stamps[1:], noise=NOISE)  # all of it in one call
    values, keys, biases = Values(), np.arange(len(stamps)), 1000 + np.arange(len(stamps))
    whole = preintegrate(imu, np.zeros_like(stamps), stamps, noise=NOISE)
    guess = whole.predict(start, np.zeros(3), np.zeros(3), DOWN)
    values.insert(keys, ExtendedPose.from_rotation_position_velocity(guess.rotation, fixes, guess.velocity))
    values.insert(biases, np.zeros((len(keys), 6)))
    graph = FactorGraph()
    graph.add(CombinedImu(keys[:-1], biases[:-1], keys[1:], biases[1:], motion))
    graph.add(LeverArmPosition(keys, fixes, Isotropic(1.0), lever_arm=ARM))
    graph.add(Prior(biases[0], np.zeros(6), Isotropic(0.1)))
    solution = solve(graph, values)
    found = solution.values.at(keys)
    error = np.sqrt(np.mean(np.sum((found.position - truth.position) ** 2, axis=1)))
    sigma = np.sqrt(Marginals(graph, solution.values).covariance(biases[-1])[0, 0])
    print(f"{solution.status} in {solution.iterations} steps: position within {error:.2f} m of the truth, fixes 1.73 m")
    print(f"gyroscope bias {solution.values.at(biases[-1])[0]:.4f} +- {sigma:.4f} rad/s, true 0.0040")


if __name__ == "__main__":
    main()
