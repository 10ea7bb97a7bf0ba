"""What de-skewing is worth: the same walk without it, with a constant-velocity model, and with the IMU.

python examples/deskew_ablation.py [SECONDS]
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from heliograph.config import CloudConfig, MapConfig, RunConfig
from heliograph.data import Trajectory
from heliograph.maps import GlobalMap
from heliograph.metrics import absolute_trajectory_error, associate, map_sharpness
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, simulate

CHOICES = {
    "off": (RunConfig(cloud=CloudConfig(deskew="off")), {"lidar", "imu"}),
    "constant velocity": (RunConfig(), {"lidar"}),
    "imu": (RunConfig(), {"lidar", "imu"}),
}


def main() -> None:
    scenario = SCENARIOS["room"].thinned(columns=256, duration=float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
    print(f"{'de-skewing':<18} {'ATE mm':>7} {'map thickness mm':>17}")
    for name, (config, sensors) in CHOICES.items():
        simulation = simulate(scenario, seed=1, threads=2)
        # Smaller planes for a small room; everything else is as `heliograph run` has it.
        odometry = make_odometry(
            replace(config, map=MapConfig(voxel=0.2)), simulation.rig, frozenset(sensors), threads=2
        )
        results = [result for message in simulation for result in odometry.add(message)] + odometry.finish()
        world_map = GlobalMap(0.05)
        for result in results:
            world_map.insert(result.points_imu, None, result.T_odom_imu)
        stamps = np.array([r.end_ns for r in results])
        estimate = Trajectory(stamps_ns=stamps, T_frame_body=np.stack([r.T_odom_imu for r in results]))
        truth = Trajectory(stamps_ns=stamps, T_frame_body=simulation.truth.pose(stamps))
        error = absolute_trajectory_error(associate(estimate, truth))
        thickness = map_sharpness(world_map.points(), 0.3).thickness
        print(f"{name:<18} {1e3 * error.rmse:7.1f} {1e3 * thickness:17.1f}")


if __name__ == "__main__":
    main()
