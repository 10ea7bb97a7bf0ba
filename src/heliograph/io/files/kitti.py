"""KITTI folders: raw drives and odometry sequences."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.guard.limits import MAX_NS
from heliograph.io.files.tum import parse_seconds
from heliograph.io.raw import RawCloud, RawFix, RawImu, RawMessage, RawSource, TopicInfo
from heliograph.lie import se3

__all__ = ["open_kitti"]

_CLOUDS, _IMU, _FIX = "/velodyne_points", "/imu/data", "/gps/fix"
_LIDAR_FRAME, _IMU_FRAME = "velo_link", "imu_link"
_OXTS_VALUES = 30  # the drives' dataformat.txt counts them


def open_kitti(paths: Sequence[Path]) -> RawSource | None:
    """Open one KITTI folder.

    Parameters
    ----------
    paths : sequence of Path
        One folder: a raw drive (``velodyne_points/``, ``oxts/``) or a sequence of the odometry benchmark
        (``velodyne/``, ``times.txt``).

    Returns
    -------
    RawSource or None
        None for any other input.

    Raises
    ------
    FormatError
        A folder of that kind that lacks its stamps or its scans.
    """
    if len(paths) != 1 or not paths[0].is_dir():
        return None
    if (paths[0] / "velodyne_points").is_dir():
        return _RawDrive(paths[0])
    if (paths[0] / "velodyne").is_dir() and (paths[0] / "times.txt").is_file():
        return _OdometrySequence(paths[0])
    return None


def _text(path: Path) -> str:
    return plain_file(path, TABLE).read_text(encoding="utf-8", errors="replace")


def _read_points(path: Path) -> NDArray[np.float32]:
    """Return ``(N, 4)`` x y z reflectance of a ``.bin`` or ``.txt`` scan; `ValueError` if it is cut short."""
    if path.suffix == ".bin":
        return np.fromfile(plain_file(path, TABLE), dtype=np.float32).reshape(-1, 4)
    return np.loadtxt(plain_file(path, TABLE), dtype=np.float32, ndmin=2).reshape(-1, 4)


def _numbered(folder: Path, suffixes: Sequence[str]) -> dict[int, Path]:
    """Return the files by the number that is their name: some drives miss a few."""
    return {
        int(path.stem): path for path in sorted(folder.glob("*")) if path.suffix in suffixes and path.stem.isdecimal()
    }


class _Folder:
    """What both kinds share: events, and scans that are read one at a time."""

    description: str
    topics: tuple[TopicInfo, ...]

    def __init__(self) -> None:
        self.events: list[Event] = []

    def close(self) -> None:
        """Nothing stays open between iterations."""

    def _note(self, event: Event) -> None:
        if event not in self.events:
            self.events.append(event)

    def _scan(self, path: Path, stamp_ns: int) -> NDArray[np.float32] | None:
        try:
            return _read_points(path)
        except (ValueError, OSError, MemoryError) as error:
            message = f"{path.name} cannot be read ({str(error)[:100]}); the scan is left out"
            self._note(Event(code="damaged-scan", message=message, stamp_ns=stamp_ns))
            return None


class _RawDrive(_Folder):
    """A raw drive: the scans are as measured, each point at its own time.

    The files carry no time of the points. The scanner turns clockwise seen from above, begins behind the car and passes
    its front, where it triggers the cameras, half-way (Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR
    2013; the stamps of start, front and end in the drives): the azimuth gives the fraction of the turn.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._scans = _numbered(folder / "velodyne_points" / "data", (".bin", ".txt"))
        if not self._scans:
            raise FormatError(folder, "holds no scans in velodyne_points/data; check the extracted archive")
        names = ("timestamps_start.txt", "timestamps.txt", "timestamps_end.txt")
        self._times = [_read_dates(folder / "velodyne_points" / name) for name in names]
        self._check(max(self._scans), min(len(times) for times in self._times), "velodyne_points")
        self._oxts = _numbered(folder / "oxts" / "data", (".txt",))
        self._oxts_times = _read_dates(folder / "oxts" / "timestamps.txt") if self._oxts else np.empty(0, np.int64)
        if self._oxts:
            self._check(max(self._oxts), len(self._oxts_times), "oxts")
        self.description = f"KITTI raw drive {folder.name}"
        kinds = ((_CLOUDS, "lidar", self._scans), (_IMU, "imu", self._oxts), (_FIX, "gnss", self._oxts))
        self.topics = tuple(
            TopicInfo(name=name, message_type=f"kitti/{kind}", kind=kind, count=len(files))
            for name, kind, files in kinds
            if files
        )

    def _check(self, last: int, stamps: int, part: str) -> None:
        if last >= stamps:
            raise FormatError(
                self._folder / part, f"has {stamps} stamps, but a file of number {last}; it is incomplete"
            )

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield scans at their end, inertial samples and fixes at their stamp, in time order."""
        clouds = self._clouds() if _CLOUDS in topics else iter(())
        oxts = self._samples(topics) if topics & {_IMU, _FIX} else iter(())
        yield from heapq.merge(clouds, oxts, key=lambda message: message.received_ns)

    def _clouds(self) -> Iterator[RawMessage]:
        for number, path in self._scans.items():
            start, front, end = (int(times[number]) for times in self._times)
            points = self._scan(path, front)
            if points is None:
                continue
            turn = 0.5 * (1.0 - np.arctan2(points[:, 1], points[:, 0]) / np.pi)
            columns: dict[str, NDArray[np.generic]] = {
                name: points[:, i] for i, name in enumerate(("x", "y", "z", "intensity"))
            }
            columns["time"] = ((start - front + turn * (end - start)) * 1e-9).astype(np.float32)
            yield RawCloud(
                topic=_CLOUDS,
                received_ns=end,
                stamp_ns=front,
                frame_id=_LIDAR_FRAME,
                columns=columns,
                layout="kitti-raw",
            )

    def _samples(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        for number, path in self._oxts.items():
            stamp = int(self._oxts_times[number])
            try:
                values = [float(word) for word in _text(path).split()]
            except (ValueError, OSError):
                values = []
            if len(values) < _OXTS_VALUES - 5:
                message = f"{path.name} holds {len(values)} of {_OXTS_VALUES} values; the sample is left out"
                self._note(Event(code="damaged-sample", message=message, stamp_ns=stamp))
                continue
            if _IMU in topics:
                yield _imu(values, stamp)
            if _FIX in topics:
                yield _fix(values, stamp)

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return the day's calibration, if ``calib_imu_to_velo.txt`` lies in the drive's folder or the one above."""
        for folder in (self._folder, self._folder.resolve().parent):
            path = folder / "calib_imu_to_velo.txt"
            if path.is_file():
                return se3.inverse(_read_calibration(path)), "KITTI calib_imu_to_velo.txt"
        return None


def _imu(values: Sequence[float], stamp: int) -> RawImu:
    """Take ``ax ay az`` and ``wx wy wz`` (body axes: forward, left, up), not the levelled ``af al au``."""
    return RawImu(
        topic=_IMU,
        received_ns=stamp,
        stamp_ns=stamp,
        frame_id=_IMU_FRAME,
        gyro=(values[17], values[18], values[19]),
        accel=(values[11], values[12], values[13]),
        has_orientation=True,
    )


def _fix(values: Sequence[float], stamp: int) -> RawFix:
    return RawFix(
        topic=_FIX,
        received_ns=stamp,
        stamp_ns=stamp,
        frame_id=_IMU_FRAME,
        latitude_deg=values[0],
        longitude_deg=values[1],
        altitude=values[2],
        covariance_enu=np.eye(3) * values[23] ** 2,
        valid=True,
    )


def _read_dates(path: Path) -> NDArray[np.int64]:
    """Read lines such as ``2011-09-26 13:02:25.594360375`` as nanoseconds since 1970."""
    try:
        lines = _text(path).split("\n")
    except OSError as error:
        raise FormatError(
            path, f"cannot be read ({error.strerror}); the drive cannot be used without its stamps"
        ) from error
    stamps = []
    for number, line in enumerate(lines, start=1):
        if line.strip():
            try:
                stamps.append(_nanoseconds(line.strip()))
            except (ValueError, OverflowError):
                raise FormatError(path, f"line {number} is no date and time: {line.strip()[:40]!r}") from None
    return np.array(stamps, dtype=np.int64)


def _nanoseconds(date: str) -> int:
    """Return a date as nanoseconds since 1970; a year beyond what they count would come round without a word."""
    seconds = int(np.datetime64(date[:19], "s").astype(np.int64))
    if not 0 <= seconds * 1_000_000_000 <= MAX_NS:
        raise ValueError(date)
    return int(np.datetime64(date, "ns").astype(np.int64))


def _read_calibration(path: Path) -> NDArray[np.float64]:
    """Read ``T_velo_imu`` from the lines ``R:`` (9 numbers) and ``T:`` (3)."""
    values: dict[str, list[str]] = {}
    for line in _text(path).splitlines():
        key, _, rest = line.partition(":")
        values[key.strip()] = rest.split()
    T_velo_imu = np.eye(4)
    try:
        T_velo_imu[:3, :3] = np.array(values["R"], dtype=np.float64).reshape(3, 3)
        T_velo_imu[:3, 3] = np.array(values["T"], dtype=np.float64)
    except (KeyError, ValueError):
        raise FormatError(path, "has no lines 'R:' with 9 numbers and 'T:' with 3") from None
    R = T_velo_imu[:3, :3]
    if not np.isfinite(T_velo_imu).all() or np.abs(R.T @ R - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise FormatError(path, "has an 'R:' that is no rotation, or numbers that are not finite")
    return T_velo_imu


class _OdometrySequence(_Folder):
    """A sequence of the odometry benchmark: the scans are already free of motion distortion, there is no IMU."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._scans = _numbered(folder / "velodyne", (".bin",))
        if not self._scans:
            raise FormatError(folder, "holds no scans in velodyne/; check the extracted archive")
        path = folder / "times.txt"
        try:
            self._times = [parse_seconds(word) for word in _text(path).split()]
        except (ValueError, OSError) as error:
            raise FormatError(path, f"does not hold one stamp in seconds a line: {error}") from None
        if max(self._scans) >= len(self._times):
            raise FormatError(path, f"has {len(self._times)} stamps, but there is a scan of number {max(self._scans)}")
        self.description = f"KITTI odometry sequence {folder.name}"
        self.topics = (TopicInfo(name=_CLOUDS, message_type="kitti/lidar", kind="lidar", count=len(self._scans)),)
        message = "KITTI removed the motion distortion from these scans; all points are taken to be of one instant"
        self._note(Event(code="already-deskewed", message=message, severity="info"))

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield the scans in order."""
        for number, path in self._scans.items() if _CLOUDS in topics else ():
            stamp = self._times[number]
            points = self._scan(path, stamp)
            if points is None:
                continue
            columns: dict[str, NDArray[np.generic]] = {
                name: points[:, i] for i, name in enumerate(("x", "y", "z", "intensity"))
            }
            columns["t"] = np.zeros(len(points), dtype=np.uint32)
            yield RawCloud(
                topic=_CLOUDS,
                received_ns=stamp,
                stamp_ns=stamp,
                frame_id=_LIDAR_FRAME,
                columns=columns,
                layout="kitti-odometry",
            )

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return None: there is no IMU."""
        return None
