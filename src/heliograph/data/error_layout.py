"""Where each error of a navigation state stands in its covariance, and in every vector or Jacobian over its errors.

Rotation is a right perturbation about body axes, position and velocity are errors in ``odom``, gravity is a direction
on S(2). A covariance of `NAV_DIM` rows ends there; one of `MOUNTED_DIM` also holds the mounting (rotation about lidar
axes, right; lever arm along imu axes), one of `FULL_DIM` the IMU's clock as well (offset at the state's stamp, drift),
one of `WHEELED_DIM` the scale of wheels or legs too.
"""

from __future__ import annotations

__all__ = [
    "ACCEL_BIAS",
    "BIASES",
    "CALIBRATION",
    "CLOCK",
    "DRIFT",
    "FULL_DIM",
    "GRAVITY",
    "GYRO_BIAS",
    "LEVER_ARM",
    "MOUNTED_DIM",
    "MOUNTING",
    "MOUNTING_ROTATION",
    "NAV",
    "NAV_DIM",
    "POSE",
    "POSE_DIM",
    "POSITION",
    "ROTATION",
    "VELOCITY",
    "WHEELED_DIM",
    "WHEEL_SCALE",
]

ROTATION = slice(0, 3)
POSITION = slice(3, 6)
VELOCITY = slice(6, 9)
GYRO_BIAS = slice(9, 12)
ACCEL_BIAS = slice(12, 15)
GRAVITY = slice(15, 17)
MOUNTING_ROTATION = slice(17, 20)
LEVER_ARM = slice(20, 23)
CLOCK = 23
DRIFT = 24
WHEEL_SCALE = 25

POSE_DIM, NAV_DIM, MOUNTED_DIM, FULL_DIM, WHEELED_DIM = 6, 17, 23, 25, 26
"""Rows of a pose, of what inertial propagation moves, with the mounting, with the clock, with the wheels too."""

POSE = slice(0, POSE_DIM)
BIASES = slice(GYRO_BIAS.start, ACCEL_BIAS.stop)
NAV = slice(0, NAV_DIM)
MOUNTING = slice(NAV_DIM, MOUNTED_DIM)
CALIBRATION = slice(NAV_DIM, FULL_DIM)
"""Blocks that are often taken together; the calibration is mounting and clock."""
