"""Every default of Heliograph, once: frozen dataclasses, read from and written to TOML."""

from __future__ import annotations

from dataclasses import dataclass, field

from heliograph.config_checks import check_choice, check_range

__all__ = ["CloudConfig", "FilterConfig", "ImuConfig", "InputConfig", "MapConfig", "OutputConfig", "RunConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class InputConfig:
    """How a recording is read; an empty string or None means: infer it from the data.

    Parameters
    ----------
    lidar_topic, imu_topic : str
        Topics to use.
    point_time_field : str
        Field that holds the per-point time.
    point_time_unit : str
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``.
    point_time_reference : str
        What the per-point times count from: ``"start"``, ``"middle"``, ``"end"`` (of the sweep, at the header stamp) or
        ``"absolute"``.
    accel_unit : str
        ``"m/s^2"`` or ``"g"``.
    gyro_unit : str
        ``"rad/s"`` or ``"deg/s"``.
    extrinsic : str
        TOML file with ``T_imu_lidar`` as ``rotation`` (3x3 or quaternion xyzw) and ``translation`` [m].
    start, duration : float
        Part of the recording to use [s]; a duration of 0 means: to the end.
    """

    lidar_topic: str = ""
    imu_topic: str = ""
    point_time_field: str = ""
    point_time_unit: str = ""
    point_time_reference: str = ""
    accel_unit: str = ""
    gyro_unit: str = ""
    extrinsic: str = ""
    start: float = 0.0
    duration: float = 0.0

    def __post_init__(self) -> None:
        check_choice(self, "point_time_unit", "", "s", "ms", "us", "ns")
        check_choice(self, "point_time_reference", "", "start", "middle", "end", "absolute")
        check_choice(self, "accel_unit", "", "m/s^2", "g")
        check_choice(self, "gyro_unit", "", "rad/s", "deg/s")
        check_range(self, "start", "duration", low=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuConfig:
    """Start and noise of the inertial model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudConfig:
    """What happens to a scan before it is matched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapConfig:
    """The local map."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterConfig:
    """The iterated error-state Kalman filter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputConfig:
    """What a run writes.

    Parameters
    ----------
    map_voxel : float
        Edge of the output map's voxels, one averaged point each [m].
    map_format : str
        ``"ply"``, ``"pcd"`` or ``"laz"``.
    body : str
        Frame whose poses are written: ``"imu"``, ``"lidar"`` or a frame of the recording.
    """

    map_voxel: float = 0.1
    map_format: str = "ply"
    body: str = "imu"

    def __post_init__(self) -> None:
        check_range(self, "map_voxel", low=0.0)
        check_choice(self, "map_format", "ply", "pcd", "laz")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """All of a run.

    Parameters
    ----------
    odometry : str
        ``"filter"``.
    sensors : str
        ``"auto"`` (what the recording holds), ``"lidar,imu"``, ``"lidar"`` or ``"imu"``.
    threads : int
        0 means the smaller of 2 and the number of cores.
    """

    odometry: str = "filter"
    sensors: str = "auto"
    threads: int = 0
    input: InputConfig = field(default_factory=InputConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    cloud: CloudConfig = field(default_factory=CloudConfig)
    map: MapConfig = field(default_factory=MapConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    output: OutputConfig = field(default_factory=OutputConfig)

    def __post_init__(self) -> None:
        check_choice(self, "odometry", "filter")
        check_choice(self, "sensors", "auto", "lidar,imu", "lidar", "imu")
        check_range(self, "threads", low=0)
