"""Native kernels of Heliograph; private, wrapped by the Python rooms."""

from typing import Annotated, Any

import numpy
from numpy.typing import NDArray

def deskew(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    offsets_ns: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    times_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    R_ref_body: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order="C", device="cpu", writable=False)],
    p_ref_body: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    T_body_lidar: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    threads: int,
) -> NDArray[numpy.float32]: ...
def voxel_downsample(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    leaf: float,
) -> NDArray[numpy.int32]: ...
def range_gate(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    min_range: float,
    max_range: float,
) -> NDArray[numpy.int32]: ...
def propagate(
    stamps_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gyro: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    accel: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    t0_ns: int,
    t1_ns: int,
    R_odom_imu: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order="C", device="cpu", writable=False)],
    vectors: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    g_basis: Annotated[NDArray[numpy.float64], dict(shape=(3, 2), order="C", device="cpu", writable=False)],
    model: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> tuple[Any, ...]: ...

def decode_points(
    x: object, y: object, z: object, time: object | None, intensity: object | None, ring: object | None
) -> tuple[Any, ...]: ...
def sweep_offsets(
    times: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    first: float,
    ns_per_unit: float,
    longest_ns: float,
) -> tuple[Any, ...]: ...

class VoxelMap:
    def __init__(
        self,
        voxel: float,
        levels: int,
        min_points: int,
        max_points: int,
        max_thickness: float,
        min_spread: float,
        point_spacing: float,
    ) -> None: ...
    def insert(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
        T_body_lidar: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    ) -> float: ...
    def prune(
        self,
        centre: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
        radius: float,
        max_voxels: int,
    ) -> None: ...
    def __len__(self) -> int: ...
    def bytes(self) -> int: ...
    def planes(self) -> NDArray[numpy.float64]: ...

class GlobalMap:
    def __init__(self, voxel: float) -> None: ...
    def insert(
        self,
        points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        intensity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        T_map_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def __len__(self) -> int: ...
    def bytes(self) -> int: ...
    def points(self) -> NDArray[numpy.float32]: ...
    def intensity(self) -> NDArray[numpy.float32]: ...
    def counts(self) -> NDArray[numpy.float32]: ...

def match_planes(
    map: VoxelMap,
    points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    before_end: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    T_body_lidar: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    gate: float,
    kernel: float,
    sigma: float,
    fallback_stride: int,
    fallback_range: float,
    columns: int,
    threads: int,
) -> tuple[Any, ...]: ...
def match_points(
    map: VoxelMap,
    points_body: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    before_end: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    T_odom_body: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    T_body_lidar: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    gate: float,
    kernel: float,
    sigma: float,
    columns: int,
    threads: int,
) -> tuple[Any, ...]: ...
def query_planes(
    map: VoxelMap,
    points_odom: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    gate: float,
    fallback_stride: int,
    fallback_range: float,
) -> tuple[Any, ...]: ...

class Scene:
    def __init__(
        self,
        packed: Annotated[NDArray[numpy.float64], dict(shape=(None, 18), order="C", device="cpu", writable=False)],
        shapes: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ) -> None: ...
    def __len__(self) -> int: ...
    def cast(
        self,
        directions: NDArray[numpy.float64],
        T_world_sensor: NDArray[numpy.float64],
        min_range: float,
        max_range: float,
        threads: int,
    ) -> tuple[NDArray[numpy.float64], NDArray[numpy.float32], NDArray[numpy.int32]]: ...
