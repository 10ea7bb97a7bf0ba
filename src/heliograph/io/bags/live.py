"""Messages as a driver hands them over, outside any recording: to clouds, scans and samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.config import InputConfig
from heliograph.data import Event, ImuBatch, Scan
from heliograph.errors import DataError
from heliograph.io.bags.messages import point_columns
from heliograph.io.inference.record import Inference
from heliograph.io.inference.scans import PointTiming, to_scan
from heliograph.io.inference.timing import infer_timing
from heliograph.io.raw import RawCloud

__all__ = ["LiveScans", "cloud_of_array", "cloud_of_message", "sample_of_message"]


def cloud_of_message(message: Any, *, received_ns: int | None = None) -> RawCloud:  # noqa: ANN401
    """Return a ``sensor_msgs/PointCloud2`` as named columns, views of its data.

    Parameters
    ----------
    message : object
        Anything with the message's fields: of rclpy, of rosbags, or one's own.
    received_ns : int, optional
        When it came [ns]; its stamp if not given.

    Raises
    ------
    DataError
        Data shorter than the header says, or a field beyond its point.
    """
    stamp_ns = _stamp_ns(message)
    step, width, height = int(message.point_step), int(message.width), int(message.height)
    columns = point_columns(
        memoryview(message.data).cast("B"),
        tuple((field.name, int(field.offset), int(field.datatype), int(field.count)) for field in message.fields),
        ">" if message.is_bigendian else "<",
        (height, width),
        (max(int(message.row_step), width * step), step),
    )
    return RawCloud(
        topic="live",
        received_ns=stamp_ns if received_ns is None else received_ns,
        stamp_ns=stamp_ns,
        frame_id=str(message.header.frame_id),
        columns=columns,
    )


def cloud_of_array(
    points: NDArray[np.void], *, stamp_ns: int, received_ns: int | None = None, frame_id: str = "lidar"
) -> RawCloud:
    """Return a structured array as a cloud: ``x``, ``y``, ``z`` [m]; times, rings, intensities by their usual names.

    Raises
    ------
    DataError
        An array without fields.
    """
    if points.dtype.names is None:
        raise DataError(
            f"a cloud needs named fields x, y, z and a time (a structured array); this is of {points.dtype}"
        )
    return RawCloud(
        topic="live",
        received_ns=stamp_ns if received_ns is None else received_ns,
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        columns={name: points[name] for name in points.dtype.names},
    )


def sample_of_message(message: Any, *, received_ns: int | None = None) -> ImuBatch:  # noqa: ANN401
    """Return a ``sensor_msgs/Imu``, in SI units as its definition asks, as a batch of one sample."""
    stamp_ns, w, a = _stamp_ns(message), message.angular_velocity, message.linear_acceleration
    return ImuBatch(
        stamps_ns=np.array([stamp_ns], dtype=np.int64),
        gyro=np.array([[w.x, w.y, w.z]], dtype=np.float64),
        accel=np.array([[a.x, a.y, a.z]], dtype=np.float64),
        received_ns=stamp_ns if received_ns is None else received_ns,
        frame_id=str(message.header.frame_id),
    )


def _stamp_ns(message: Any) -> int:  # noqa: ANN401
    stamp = message.header.stamp
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsecs
    seconds = stamp.sec if hasattr(stamp, "sec") else stamp.secs
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


class LiveScans:
    """Clouds in, scans out, with the times of the points inferred from the first clouds as for a recording.

    Parameters
    ----------
    config : InputConfig, optional
        What overrules the inference: ``point_time_field``, ``point_time_unit``, ``point_time_reference``.
    probe : int
        Clouds that are held until it is clear how their points are timed.
    """

    def __init__(self, config: InputConfig | None = None, *, probe: int = 5) -> None:
        self.events: list[Event] = []
        self.inferences: tuple[Inference, ...] = ()
        """What was inferred of the points' times, with the evidence."""
        self._config, self._probe = config if config is not None else InputConfig(), max(probe, 1)
        self._held: list[RawCloud] = []
        self._timing: PointTiming | None = None

    def add(self, cloud: RawCloud) -> list[Scan]:
        """Take a cloud and return the scans that it made ready: none at first, then the held ones, then one each.

        Raises
        ------
        DataError
            Clouds without coordinates, or whose stamps run backwards.
        ConfigError
            An overruling field that is not there.
        """
        if self._timing is not None:
            return [to_scan(cloud, self._timing)]
        self._held.append(cloud)
        return self.finish() if len(self._held) >= self._probe else []

    def finish(self) -> list[Scan]:
        """Return the scans still held: no more clouds come, or there is no time to wait."""
        if not self._held:
            return []
        found = infer_timing(self._held, self._config)
        self._timing, self.inferences = found.timing, found.inferences
        self.events += found.events
        held, self._held = self._held, []
        return [to_scan(cloud, found.timing) for cloud in held]
