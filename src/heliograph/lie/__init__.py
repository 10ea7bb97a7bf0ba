"""Lie groups of robotics, batched.

Array functions live in the modules `so3`, `se3`, `se23`, `so2`, `se2` and `s2`; `SO3`, `SE3`, `ExtendedPose`, `SO2`,
`SE2` and `S2` are values.
"""

from heliograph.lie import s2, se2, se3, se23, so2, so3
from heliograph.lie.groups import S2, SE2, SE3, SO2, SO3, ExtendedPose
from heliograph.lie.interpolate import interpolate_se3

__all__ = [
    "S2",
    "SE2",
    "SE3",
    "SO2",
    "SO3",
    "ExtendedPose",
    "interpolate_se3",
    "s2",
    "se2",
    "se3",
    "se23",
    "so2",
    "so3",
]
