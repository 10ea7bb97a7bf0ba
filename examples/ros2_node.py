"""Heliograph as a ROS 2 node: python examples/ros2_node.py --ros-args -r points:=/os/points -r imu:=/os/imu."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from heliograph.config import RunConfig
from heliograph.data import NavState, Rig
from heliograph.io import LiveScans, cloud_of_message, sample_of_message
from heliograph.lie import so3
from heliograph.odometry import LiveOdometry, make_odometry


class Bridge:
    """Messages in, poses out: all but ROS itself, so that it also runs on a recorded stream."""

    def __init__(self, rig: Rig, on_result: Callable, config: RunConfig | None = None, **options: int) -> None:
        odometry = make_odometry(config := config or RunConfig(), rig, frozenset({"lidar", "imu"}), threads=2)
        self.scans = LiveScans(config.input)
        self.live = LiveOdometry(odometry, on_result=on_result, imu=config.imu, **options)

    def on_imu(self, message: object) -> NavState | None:
        """Take a sensor_msgs/Imu; return the pose at it."""
        self.live.add(sample_of_message(message))
        return self.live.pose()

    def on_points(self, message: object) -> None:
        """Take a sensor_msgs/PointCloud2; its result comes when it is ready."""
        for scan in self.scans.add(cloud_of_message(message)):
            self.live.add(scan)


def main() -> None:
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.executors import ExternalShutdownException
    from sensor_msgs.msg import Imu, PointCloud2

    rclpy.init()
    publisher = (node := rclpy.create_node("heliograph")).create_publisher(Odometry, "odometry", 50)
    rig = Rig(T_imu_lidar=np.eye(4), source="this script")  # the mounting of yours
    bridge = Bridge(rig, lambda result: node.get_logger().info(f"scan {result.index} {result.status}"))

    def on_imu(message: Imu) -> None:
        if (state := bridge.on_imu(message)) is not None:
            out = Odometry(child_frame_id=message.header.frame_id)
            out.header.stamp, out.header.frame_id, pose = message.header.stamp, "odom", out.pose.pose
            (p := pose.position).x, p.y, p.z = state.p_odom.tolist()
            (q := pose.orientation).x, q.y, q.z, q.w = so3.to_quaternion(state.R_odom_imu).tolist()
            publisher.publish(out)

    node.create_subscription(Imu, "imu", on_imu, 1000)
    node.create_subscription(PointCloud2, "points", bridge.on_points, 10)
    with suppress(KeyboardInterrupt, ExternalShutdownException), bridge.live:  # what has come is finished
        rclpy.spin(node)


if __name__ == "__main__":
    main()
