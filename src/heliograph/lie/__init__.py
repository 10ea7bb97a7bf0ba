"""Lie groups of robotics, batched: array functions in `so3`, `se3`, `so2`, `se2`, `s2`; values in `SO3`, `SE3`, `SO2`, `SE2`, `S2`."""

from heliograph.lie import s2, se2, se3, so2, so3
from heliograph.lie.groups import S2, SE2, SE3, SO2, SO3
from heliograph.lie.interpolate import interpolate_se3

__all__ = ["S2", "SE2", "SE3", "SO2", "SO3", "interpolate_se3", "s2", "se2", "se3", "so2", "so3"]
