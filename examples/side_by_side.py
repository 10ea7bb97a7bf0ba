"""LiDAR alone smears and jumps, the IMU alone drifts as t^2, both together follow: a hand-held walk in a room.

python examples/side_by_side.py FIGURE.png [SECONDS]
"""

from __future__ import annotations

import sys

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from heliograph.config import RunConfig
from heliograph.data import ScanResult
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, Simulation, simulate

mpl.use("Agg")
from matplotlib import pyplot as plt

CHOICES = {"LiDAR": frozenset({"lidar"}), "IMU": frozenset({"imu"}), "both": frozenset({"lidar", "imu"})}


def track(simulation: Simulation, sensors: frozenset[str]) -> list[ScanResult]:
    odometry = make_odometry(RunConfig(), simulation.rig, sensors, threads=2)
    results = [result for message in simulation for result in odometry.add(message)]
    return results + odometry.finish()


def position_error(results: list[ScanResult], simulation: Simulation) -> tuple[NDArray, NDArray]:
    """Return seconds and distance from the truth, both put together at the first pose."""
    stamps, T = np.array([r.end_ns for r in results]), np.stack([r.T_odom_imu for r in results])
    T_truth = simulation.truth.pose(stamps)
    shift = (T_truth[0] @ np.linalg.inv(T[0]) @ T)[:, :3, 3] - T_truth[:, :3, 3]
    return (stamps - stamps[0]) * 1e-9, np.linalg.norm(shift, axis=1)


def main() -> None:
    scenario = SCENARIOS["room"].thinned(columns=256, duration=float(sys.argv[2]) if len(sys.argv) > 2 else 15.0)
    shaken = scenario.varied(gait={"frequency": 2.4, "yaw_deg": 25.0, "pitch_deg": 10.0, "roll_deg": 10.0})
    figure, axes = plt.subplots(1, 4, figsize=(16, 4), layout="constrained")
    for (name, sensors), view in zip(CHOICES.items(), axes[1:], strict=True):
        simulation = simulate(shaken, seed=1, threads=2)
        results = track(simulation, sensors)
        seconds, error = position_error(results, simulation)
        axes[0].semilogy(seconds, np.maximum(error, 1e-4), label=name)
        print(f"{name}: {error[-1]:.3f} m from the truth after {seconds[-1]:.1f} s, at most {error.max():.3f} m")
        cloud = np.concatenate([r.points_imu @ r.T_odom_imu[:3, :3].T + r.T_odom_imu[:3, 3] for r in results])
        view.plot(*cloud[np.abs(cloud[:, 2]) < 0.1, :2].T, ",", color="0.5")  # a slice at the sensor's height
        view.plot(*np.stack([r.T_odom_imu[:2, 3] for r in results]).T, "r")
        view.set(title=name, aspect="equal", xlabel="x [m]")
    axes[0].set(xlabel="time [s]", ylabel="distance from the truth [m]")
    axes[0].legend()
    figure.savefig(sys.argv[1], dpi=100)


if __name__ == "__main__":
    main()
