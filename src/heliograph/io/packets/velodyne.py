"""Velodyne packets to points, through ``velodyne-decoder``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import FormatError, MissingDependencyError
from heliograph.guard.boundary import reason
from heliograph.io.raw import RawCloud, RawMessage

__all__ = ["PACKET_SIZE", "VelodyneDecoder", "velodyne_decoder"]

PACKET_SIZE = 1206
LIDAR_FRAME = "velodyne"
_MAX_WAITING = 100  # packets that never agree are noise
_NS = 1_000_000_000


def velodyne_decoder() -> Any:  # noqa: ANN401 - an optional package without types
    """Return the module ``velodyne_decoder``, or raise `MissingDependencyError` with the install command."""
    try:
        import velodyne_decoder as module
    except ImportError as error:
        raise MissingDependencyError(
            f"Velodyne packets need velodyne-decoder: pip install 'heliograph[velodyne]' ({error})"
        ) from error
    return module


class VelodyneDecoder:
    """Collects one sensor's packets into sweeps.

    Parameters
    ----------
    topic : str
        Topic to give the clouds.
    frame_id : str
        Frame to give them.
    device_clock : bool
        Stamp by the sensor's own clock (seconds since the full hour, on the host's hour) instead of the time at which
        packets were received: free of jitter, but shifted against other sensors if no GPS sets it.
    calibration_from : Path or None
        A pcap file that may hold the calibration of an HDL-64E.

    Notes
    -----
    Sweeps are stamped at their first packet, from which the ``time`` column counts [s]. (The ROS driver stamps the last
    one by default, but then a sweep that the capture cuts short comes too early.)
    """

    def __init__(
        self, topic: str, frame_id: str = LIDAR_FRAME, device_clock: bool = False, calibration_from: Path | None = None
    ) -> None:
        module = velodyne_decoder()
        config = module.Config(timestamp_first_packet=True)
        self.bad_packets, self.why_bad = 0, ""
        if calibration_from is not None:
            try:
                config.model, config.calibration = module.hdl64e.detect_hdl64e(calibration_from)
            except ValueError as error:
                raise FormatError(calibration_from, f"is of an HDL-64E of unknown calibration: {error}") from error
            except (
                Exception
            ) as error:  # dpkt's own, where the capture is damaged; the packets themselves tell the model
                self.why_bad = reason("holds no calibration", error)
        self._stream = module.StreamDecoder(config)
        self._topic, self._frame_id, self._device_clock = topic, frame_id, device_clock
        self._received_ns = 0
        self._told = config.model is not None  # an HDL-64E's last byte is a status, not its model
        self._model: int | None = None
        self._waiting: list[tuple[float, bytes]] = []

    def feed(self, data: memoryview | bytes, received_ns: int, stamp_ns: int | None = None) -> list[RawMessage]:
        """Take one datagram and return the sweep that it completes; one that holds no points gives nothing.

        Parameters
        ----------
        data : bytes
            1206 bytes; another size (telemetry) is ignored.
        received_ns : int
            When the recorder got it [ns].
        stamp_ns : int or None
            The driver's stamp of the packet, where it differs.
        """
        if len(data) != PACKET_SIZE:
            return []
        self._received_ns = received_ns
        stamp = (received_ns if stamp_ns is None else stamp_ns) / _NS
        return [cloud for packet in self._admitted(stamp, bytes(data)) for cloud in self._decoded(*packet)]

    def finish(self) -> list[RawMessage]:
        """Return the sweep collected so far."""
        clouds = [cloud for packet in self._waiting for cloud in self._decoded(*packet)]
        self._waiting = []
        return clouds + self._safely(lambda: self._stream.finish(True))

    def _admitted(self, stamp: float, data: bytes) -> list[tuple[float, bytes]]:
        """Return the packets that are to be decoded now.

        The decoder drops a whole sweep for one packet of another model than the first. So the first two in a row that
        agree say which model it is, and one that says another is left out before it does harm.
        """
        if self._told:
            return [(stamp, data)]
        packets = [*self._waiting, (stamp, data)]
        if self._model is None and (len(packets) == 1 or packets[-2][1][-1] != data[-1]):
            self._waiting = packets[-_MAX_WAITING:]
            return []
        self._waiting, self._model = [], data[-1] if self._model is None else self._model
        admitted = [packet for packet in packets if packet[1][-1] == self._model]
        if len(admitted) < len(packets):
            self.bad_packets += len(packets) - len(admitted)
            self.why_bad = "are of another model than the rest"
        return admitted

    def _decoded(self, stamp: float, data: bytes) -> list[RawMessage]:
        return self._safely(lambda: self._stream.decode(stamp, data, True))

    def _safely(self, decode: Callable[[], tuple[Any, Any] | None]) -> list[RawMessage]:
        """Return what the decoder gives; one bad packet is no reason to lose all others."""
        try:
            return self._clouds(decode())
        except (RuntimeError, ValueError, TypeError, IndexError, OverflowError) as error:
            self.bad_packets += 1
            self.why_bad = reason("cannot be decoded", error)
            return []

    def _clouds(self, result: tuple[Any, Any] | None) -> list[RawMessage]:
        if result is None or len(result[1]) == 0:
            return []
        times, points = result
        columns: dict[str, NDArray[np.generic]] = {name: points[name] for name in ("x", "y", "z", "intensity", "time")}
        columns["ring"] = points["ring"].astype(np.uint16)
        return [
            RawCloud(
                topic=self._topic,
                received_ns=self._received_ns,
                stamp_ns=round((times.device if self._device_clock else times.host) * _NS),
                frame_id=self._frame_id,
                columns=columns,
                layout="velodyne-packets",
            )
        ]
