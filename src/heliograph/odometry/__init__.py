"""Odometry: from scans and inertial samples to poses."""

from heliograph.odometry.filter.odometry import FilterOdometry
from heliograph.odometry.protocol import Odometry, make_odometry

__all__ = ["FilterOdometry", "Odometry", "make_odometry"]
