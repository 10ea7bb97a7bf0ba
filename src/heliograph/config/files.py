"""Defaults of what is read and written."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_choice, check_range

__all__ = ["InputConfig", "OutputConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class InputConfig:
    """How a recording is read; an empty string or None means: infer it from the data.

    Parameters
    ----------
    reader : str
        Name of the reader to use, or ``"module:function"`` of one's own, which is imported; see docs/howto/plug_in.md.
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
    max_probe : float
        How much from the start is read at most to infer what is not given; a sensor that begins later is not found [s].
    max_chunk : float
        Most that one compressed chunk or message may unpack to; a larger one is damaged or hostile, and left out [MB].
    max_unpack_ratio : float
        How many times its own size a compressed file may unpack to.
    repair : bool
        Whether faults of the data that the data themselves prove are mended, each said in one line.
    """

    reader: str = ""
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
    max_probe: float = 20.0
    max_chunk: float = 256.0
    max_unpack_ratio: float = 1000.0
    repair: bool = True

    def __post_init__(self) -> None:
        check_choice(self, "point_time_unit", "", "s", "ms", "us", "ns")
        check_choice(self, "point_time_reference", "", "start", "middle", "end", "absolute")
        check_choice(self, "accel_unit", "", "m/s^2", "g")
        check_choice(self, "gyro_unit", "", "rad/s", "deg/s")
        check_range(self, "start", "duration", low=0.0)
        check_range(self, "max_probe", above=0.0, high=600.0)
        check_range(self, "max_chunk", low=1.0, high=16_000.0)
        check_range(self, "max_unpack_ratio", low=1.0, high=1e9)


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputConfig:
    """What a run writes.

    Parameters
    ----------
    map_voxel : float
        Edge of the output map's voxels, one averaged point each [m].
    surface_thickness : float
        Voxels whose averages scatter about a plane by no more (RMS) are one surface, and are averaged across the
        borders of the grid [m]; 0 leaves each voxel its own average.
    map_format : str
        ``"ply"``, ``"pcd"`` or ``"laz"``.
    body : str
        Frame whose poses are written: ``"imu"``, ``"lidar"`` or a frame of the recording.
    keyframe_distance, keyframe_angle_deg, keyframe_interval : float
        How far [m], how much [deg] and how long [s] until the next keyframe; the points between two move as one where a
        back-end moves the run.
    drop_moving : bool
        Whether points that other scans saw through, as people and vehicles that went by, are left out of the map.
    moving_votes, moving_ratio : int, float
        Scans that must have seen through a place before it is dropped, and how many for each keyframe that saw
        something there. More keep more.
    moving_reach : float
        From how far it counts [m].
    moving_margin : float
        How far a ray must go on behind a place at least [m].
    keep_submaps : bool
        Whether ``submaps.bin``, the points keyframe by keyframe, stays in the folder.
    checkpoint_interval : float
        How long of the recording from one checkpoint to the next, which `run --resume` goes on from after the run was
        cut off [s]; 0: none is written.
    hash_inputs : str
        What of the recording ``run.json`` has a checksum of: ``"full"``, all of it; ``"sampled"``, 16 pieces a file;
        ``"auto"``, all up to 1 GiB; ``"none"``.
    """

    map_voxel: float = 0.1
    surface_thickness: float = 0.02
    map_format: str = "ply"
    body: str = "imu"
    keyframe_distance: float = 2.0
    keyframe_angle_deg: float = 30.0
    keyframe_interval: float = 5.0
    drop_moving: bool = True
    moving_votes: int = 3
    moving_ratio: float = 1.5
    moving_reach: float = 20.0
    moving_margin: float = 0.3
    keep_submaps: bool = False
    checkpoint_interval: float = 30.0
    hash_inputs: str = "auto"

    def __post_init__(self) -> None:
        check_range(self, "map_voxel", "keyframe_distance", "keyframe_angle_deg", "keyframe_interval", above=0.0)
        check_range(self, "moving_reach", "moving_margin", above=0.0)
        check_range(self, "moving_votes", low=1)
        check_range(self, "surface_thickness", "moving_ratio", "checkpoint_interval", low=0.0)
        check_choice(self, "hash_inputs", "auto", "full", "sampled", "none")
        check_choice(self, "map_format", "ply", "pcd", "laz")
