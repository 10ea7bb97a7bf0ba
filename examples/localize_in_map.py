"""Where am I? A saved map, a robot that wakes up in it, and what it is told scan by scan.

    python examples/localize_in_map.py

The map is a simulated aisle by its exact poses; the odometry's frame of the robot is turned and moved against it.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Scan
from heliograph.lie import se3, so3
from heliograph.localization import Localizer, map_of_keyframes
from heliograph.odometry.pose_result import pose_result
from heliograph.sim.places import PLACES
from heliograph.sim.sensors import LidarModel
from heliograph.sim.world import SimulatedWorld

LIDAR = LidarModel(beams=24, columns=240, elevation_deg=(-30.0, 30.0), min_range=0.4, max_range=40.0)


def look(world: SimulatedWorld, T_world_imu: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return what the LiDAR sees from a pose, imu frame."""
    directions = LIDAR.directions()
    poses = np.broadcast_to(T_world_imu, (LIDAR.columns, 4, 4)).copy()
    seen = world.cast(directions, poses, min_range=LIDAR.min_range, max_range=LIDAR.max_range)
    hit = seen.range > 0.0
    ranges = seen.range[hit] + 0.01 * rng.standard_normal(int(hit.sum()))
    return (directions[hit] * ranges[:, None]).astype(np.float32)


def main() -> None:
    """Map one lap, wake up on the next."""
    rng = np.random.default_rng(0)
    place = PLACES["aisles"](np.random.default_rng(1))
    lap = place.course.sample(1.0)[0]
    T = np.stack([se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, yaw), [x, y, z]) for x, y, z, yaw in lap])
    saved = map_of_keyframes([look(place.world, pose, rng) for pose in T], T)
    print(f"a map of {len(saved)} submaps")

    localizer, result = Localizer(saved), None
    T_odom_world = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, 2.0), [5.0, -3.0, 0.2])
    for k in range(12, 20):
        points, stamp = look(place.world, T[k], rng), k * 10**9
        offsets = np.zeros(len(points), np.int32)
        scan = Scan(
            stamp_ns=stamp, end_ns=stamp, header_stamp_ns=stamp, received_ns=stamp, points=points, offsets_ns=offsets
        )
        result = pose_result(scan, k - 12, np.ascontiguousarray(T_odom_world @ T[k]), before=result)
        found = localizer.add(result)
        if found.T_map_imu is None:
            print(f"{k - 12} s: {found.state}, {found.places} places fit")
        else:
            error = np.linalg.norm(found.T_map_imu[:3, 3] - T[k, :3, 3])
            print(f"{k - 12} s: {found.state}, {1e3 * error:.1f} mm off, sigma {1e3 * found.sigma[3:].max():.1f} mm")


if __name__ == "__main__":
    main()
