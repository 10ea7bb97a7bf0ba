"""A LiDAR-inertial graph that grows: IMU, LiDAR steps, fixes, loops, a false one: python examples/online_lio.py."""

import numpy as np

import heliograph.graph as hg
from heliograph.data import ImuBatch, ImuNoise
from heliograph.factors import CombinedImu, LeverArmPosition, Velocity
from heliograph.imu import preintegrate
from heliograph.lie import SE3, ExtendedPose, se3, se23

NOISE = ImuNoise(gyro=1e-3, accel=1e-2, gyro_walk=1e-5, accel_walk=1e-4)
DOWN, ARM, RATE, SECONDS = np.array([0.0, 0.0, -9.80665]), np.array([0.3, 0.0, 1.2]), 100, 120
SIGMAS = np.array([0.002] * 3 + [0.03] * 3)  # of a LiDAR step: rotation first [rad, m]
X, B = hg.Symbol("X"), hg.Symbol("B")


def drive(rng: np.random.Generator) -> tuple[ImuBatch, np.ndarray, ExtendedPose]:
    """Return samples with noise and biases, stamps a second apart, and the truth: two rounds of a circle a minute."""
    stamps = np.arange(SECONDS * RATE + 1, dtype=np.int64) * (1_000_000_000 // RATE)
    turn, speed = 2.0 * np.pi / 60.0, 6.0
    t = turn * np.arange(SECONDS + 1)
    T = se3.exp(np.outer(t, [0.0, 0.0, 1.0, speed / turn, 0.0, 0.0]))
    gyro, accel = rng.normal(size=(2, len(stamps), 3)) * np.sqrt(RATE) * [[[NOISE.gyro]], [[NOISE.accel]]]
    gyro, accel = gyro + 0.003 + [0.0, 0.0, turn], accel + 0.05 + [0.0, speed * turn, 9.80665]
    truth = ExtendedPose(se23.from_rotation_position_velocity(T[:, :3, :3], T[:, :3, 3], speed * T[:, :3, 0]))
    return ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=0), stamps[::RATE], truth


def main() -> None:
    rng = np.random.default_rng(1)
    imu, stamps, truth = drive(rng)
    T = se3.from_rotation_translation(truth.rotation, truth.position)
    smoother, bias, state = hg.ISAM2(outliers=hg.OutlierRejection()), np.zeros(6), truth[0]
    for k in range(SECONDS + 1):
        graph, values = hg.FactorGraph(), hg.Values()
        if k == 0:
            graph.add(hg.Prior(X(0), SE3(T[0]), hg.Isotropic(0.01)))  # of the state's pose
            graph.add(Velocity(X(0), truth[0].velocity, hg.Isotropic(0.5)))
            graph.add(hg.Prior(B(0), np.zeros(6), hg.Diagonal([0.01] * 3 + [0.1] * 3)))
        else:
            motion, bias = preintegrate(imu, stamps[k - 1], stamps[k], noise=NOISE), smoother.estimate(B(k - 1))
            state = motion.predict(smoother.estimate(X(k - 1)), bias[:3], bias[3:], DOWN)[0]
            graph.add(CombinedImu(X(k - 1), B(k - 1), X(k), B(k), motion, gravity=DOWN))
            for i in [k - 1, k - 60] if k > 60 and k % 5 == 0 else [k - 1]:  # odometry, and loops
                measured = SE3(se3.retract(se3.inverse(T[i]) @ T[k], SIGMAS * rng.normal(size=6)))
                graph.add(hg.Between(X(i), X(k), measured, hg.Diagonal(SIGMAS)))
        if k % 20 == 10:
            fix = truth.position[k] + truth.rotation[k] @ ARM + rng.normal(size=3)
            graph.add(LeverArmPosition(X(k), fix, hg.Isotropic(1.0), lever_arm=ARM))
        if k == 70:
            graph.add(hg.Between(X(30), X(70), SE3.identity(), hg.Diagonal(SIGMAS)))  # places that look alike
        values.insert(X(k), state), values.insert(B(k), bias)
        smoother.update(graph, values)
    found = smoother.estimate(X(np.arange(SECONDS + 1))).position
    let_go = [" to ".join(map(hg.key_name, smoother.keys_of(int(number)).tolist())) for number in smoother.let_go]
    print(f"position within {np.abs(found - truth.position).max():.2f} m of the truth; let go: {', '.join(let_go)}")


if __name__ == "__main__":
    main()
