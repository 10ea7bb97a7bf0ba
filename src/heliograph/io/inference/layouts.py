"""The per-point time layouts of the drivers that people record with, as data.

Each row was checked against the driver's own source (named in ``checked``); `tests/unit/io/test_timing.py` keeps a
fixture of each. The table says what to expect; the data decide, and a contradiction is reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "DESKEWED_LAYOUTS",
    "INTENSITY_FIELDS",
    "LAYOUTS",
    "RING_FIELDS",
    "TIME_FIELDS",
    "UNITS",
    "Layout",
    "find_layout",
    "time_field",
]

UNITS: Mapping[str, float] = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
"""Nanoseconds a unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How a driver stores the time of each point.

    Parameters
    ----------
    name : str
        Short name; `heliograph simulate --layout NAME` writes it.
    message : str
        ``RawCloud.layout`` that it comes in.
    field, dtype : str
        Name and type of the per-point time; empty where there is none.
    unit : str
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``.
    reference : str
        ``"header"`` (signed, from the header stamp) or ``"absolute"``.
    fields : tuple of str
        That the driver writes beside x, y and z, and that tell it from others.
    stamp : str
        What the header stamp means, in words.
    checked : str
        The driver's source file that says so.
    """

    name: str
    message: str = "PointCloud2"
    field: str
    dtype: str
    unit: str
    reference: str
    fields: tuple[str, ...]
    stamp: str
    checked: str


LAYOUTS: tuple[Layout, ...] = (
    Layout(
        name="livox-custom",
        message="livox/CustomMsg",
        field="offset_time",
        dtype="u4",
        unit="ns",
        reference="header",
        fields=("reflectivity", "tag", "line"),
        stamp="first point (the message's timebase)",
        checked="livox_ros_driver2: msg/CustomPoint.msg, src/lddc.cpp",
    ),
    Layout(
        name="livox-pointcloud2",
        field="timestamp",
        dtype="f8",
        unit="ns",
        reference="absolute",
        fields=("intensity", "tag", "line"),
        stamp="first point",
        checked="livox_ros_driver2: LivoxPointXyzrtlt in src/comm/comm.h, src/lddc.cpp",
    ),
    Layout(
        name="ouster",
        field="t",
        dtype="u4",
        unit="ns",
        reference="header",
        fields=("intensity", "reflectivity", "ring", "range"),
        stamp="first column of the frame",
        checked="ouster-ros: include/ouster_ros/os_point.h",
    ),
    Layout(
        name="velodyne",
        field="time",
        dtype="f4",
        unit="s",
        reference="header",
        fields=("intensity", "ring"),
        stamp="last packet, so that times are negative; the first with timestamp_first_packet",
        checked="velodyne: velodyne_pointcloud/src/lib/rawdata.cpp, velodyne_driver/src/driver/driver.cpp",
    ),
    Layout(
        name="hesai",
        field="timestamp",
        dtype="f8",
        unit="s",
        reference="absolute",
        fields=("intensity", "ring"),
        stamp="start of the frame",
        # RoboSense writes the same fields; its stamp is the first or the last point's, by the driver's settings.
        checked="HesaiLidar_ROS_2.0: src/manager/source_driver_ros2.hpp; rslidar_sdk: src/msg/rs_msg",
    ),
)

DESKEWED_LAYOUTS = ("kitti-odometry",)
"""``RawCloud.layout`` of clouds whose points are all of one instant: inferring times for them would distort them."""

TIME_FIELDS = (
    "t",
    "time",
    "timestamp",
    "offset_time",
    "time_offset",
    "timeoffset",
    "time_stamp",
    "point_time",
    "point_time_offset",
    "t_offset",
    "stamp",
    "timestampoffset",
)
INTENSITY_FIELDS = ("intensity", "reflectivity", "i", "signal")
RING_FIELDS = ("ring", "line", "channel", "laser_id", "row")


def find_layout(message: str, columns: Mapping[str, NDArray[np.generic]]) -> Layout | None:
    """Return the first row of the table that a cloud fits, or None."""
    for layout in LAYOUTS:
        if message != layout.message or layout.field not in columns:
            continue
        dtype = columns[layout.field].dtype
        if f"{dtype.kind}{dtype.itemsize}" == layout.dtype and all(field in columns for field in layout.fields):
            return layout
    return None


def time_field(columns: Mapping[str, NDArray[np.generic]]) -> str | None:
    """Return the column that by its name holds the per-point time, or None."""
    lowered = {name.lower(): name for name in columns}
    return next((lowered[name] for name in TIME_FIELDS if name in lowered), None)
