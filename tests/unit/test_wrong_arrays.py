"""Public functions answer wrong arrays with one error that names the argument, or take them as documented.

For every function a call that works is written down; then one array at a time is replaced by a wrong one.
"""

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from heliograph.cloud import deskew, range_gate, voxel_downsample
from heliograph.data import GnssFix, ImuBatch, Rig, Scan, Trajectory
from heliograph.errors import DataError, HeliographError
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose, interpolate_se3, s2, se2, se3, se23, so2, so3
from heliograph.maps import GlobalMap, VoxelMap
from heliograph.metrics import align, map_sharpness
from heliograph.registration import MatchSettings, gradient_scatter, linearize

CLOUD = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 3)).astype(np.float32)
STAMPS, POSES = np.arange(2, dtype=np.int64), np.tile(np.eye(4), (2, 1, 1))
SETTINGS = MatchSettings(gate=0.5, kernel=0.1, sigma=0.01)


def filled_map():
    local_map = VoxelMap()
    local_map.insert(CLOUD, np.eye(4))
    return local_map


@dataclass(frozen=True)
class Call:
    """A function, the arrays that it takes by name, and what else it needs."""

    name: str
    function: Callable[..., object]
    arrays: dict[str, np.ndarray]
    rest: dict[str, object]


def call(name, function, rest=None, **arrays):
    return Call(name, function, arrays, rest or {})


def lie_calls():
    for module, core, dof, space in (
        (so2, np.eye(2), 1, 0),
        (so3, np.eye(3), 3, 0),
        (se2, np.eye(3), 3, 2),
        (se3, np.eye(4), 6, 3),
        (se23, np.eye(5), 9, 0),
    ):
        label = module.__name__.rpartition(".")[2]
        X = "X" if module is se23 else "T" if space else "R"
        tangent = "xi" if module in (se2, se3, se23) else "phi"
        for function in ("hat", "exp", "right_jacobian", "right_jacobian_inverse"):
            yield call(f"{label}.{function}", getattr(module, function), **{tangent: np.full(dof, 0.1)})
        for function in ("log", "inverse", "adjoint"):
            yield call(f"{label}.{function}", getattr(module, function), **{X: core})
        yield call(f"{label}.retract", module.retract, **{X: core, "d": np.full(dof, 0.1)})
        yield call(f"{label}.local", module.local, **{f"{X}_a": core, f"{X}_b": core})
        if module in (se2, se3, se23):
            yield call(f"{label}.compose", module.compose, **{f"{X}_a_b": core, f"{X}_b_c": core})
        if space:
            yield call(f"{label}.act", module.act, T=core, points=np.ones((4, space)))
            yield call(f"{label}.act_each", module.act, T=np.tile(core, (4, 1, 1)), points=np.ones((4, space)))
            parts = {"R": np.eye(space), "t": np.ones(space)}
            yield call(f"{label}.from_rotation_translation", module.from_rotation_translation, **parts)
    x, y, d = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]), np.full(2, 0.1)
    yield call("so3.left_jacobian", so3.left_jacobian, phi=x)
    yield call("so3.left_jacobian_inverse", so3.left_jacobian_inverse, phi=x)
    yield call("so3.vee", so3.vee, skew=np.zeros((3, 3)))
    yield call("so3.from_quaternion", so3.from_quaternion, xyzw=np.array([0.0, 0.0, 0.0, 1.0]))
    yield call("so3.to_quaternion", so3.to_quaternion, R=np.eye(3))
    yield call("so3.project", so3.project, M=np.eye(3))
    yield call("so3.from_two_vectors", so3.from_two_vectors, a=x, b=y)
    yield call("so3.from_rpy", so3.from_rpy, roll=np.zeros(2), pitch=np.zeros(2), yaw=np.zeros(2))
    yield call("so3.to_rpy", so3.to_rpy, R=np.eye(3))
    yield call("se23.from_parts", se23.from_rotation_position_velocity, R=np.eye(3), p=x, v=y)
    yield call("s2.project", s2.project, v=x)
    yield call("s2.basis", s2.basis, x=x)
    yield call("s2.retract", s2.retract, x=x, d=d)
    yield call("s2.retract_jacobian", s2.retract_jacobian, x=x, d=d)
    yield call("s2.local", s2.local, x=x, y=y)
    yield call("interpolate_se3", interpolate_se3, stamps_ns=STAMPS, T_frame_body=POSES, query_ns=STAMPS)
    for group, core in (
        (SO2, np.eye(2)),
        (SO3, np.eye(3)),
        (SE2, np.eye(3)),
        (SE3, np.eye(4)),
        (ExtendedPose, np.eye(5)),
    ):
        yield call(group.__name__, group, matrix=core)
        yield call(f"{group.__name__}.exp", group.exp, tangent=np.zeros(group.dof))
    yield call("S2", S2, vector=x)
    yield call("SE3 @ points", lambda points: SE3.identity() @ points, points=CLOUD.astype(float))
    yield call("SO3 @ points", lambda points: SO3.identity() @ points, points=CLOUD.astype(float))


def cloud_calls():
    path = {"path_stamps_ns": STAMPS, "R_odom_body": POSES[:, :3, :3].copy(), "p_odom": np.zeros((2, 3))}
    offsets = np.zeros(40, np.int32)
    pose = np.eye(4)
    yield call("voxel_downsample", voxel_downsample, {"leaf": 0.4}, points=CLOUD)
    yield call("range_gate", range_gate, {"min_range": 0.1, "max_range": 9.0}, points=CLOUD)
    yield call("deskew", deskew, {"stamp_ns": 0}, points=CLOUD, offsets_ns=offsets, T_body_lidar=pose, **path)
    yield call(
        "VoxelMap.insert",
        lambda **arrays: VoxelMap().insert(**arrays),
        points_body=CLOUD,
        T_odom_body=pose,
    )
    yield call("VoxelMap.prune", lambda centre_odom: filled_map().prune(centre_odom), centre_odom=np.zeros(3))
    yield call(
        "VoxelMap.planes_at",
        lambda points_odom: filled_map().planes_at(points_odom, gate=0.5),
        points_odom=CLOUD.astype(float),
    )
    insert = {"points_imu": CLOUD, "intensity": CLOUD[:, 0].copy(), "T_map_imu": pose}
    yield call("GlobalMap.insert", lambda **arrays: GlobalMap(0.1).insert(**arrays), **insert)
    match = {"points_imu": CLOUD, "T_odom_imu": pose, "before_end": CLOUD[:, 0].copy()}
    yield call("linearize", lambda **arrays: linearize(filled_map(), settings=SETTINGS, **arrays), **match)
    scatter = {"points": CLOUD, "T_odom_body": pose}
    yield call(
        "gradient_scatter", lambda **arrays: gradient_scatter(filled_map(), settings=SETTINGS, **arrays), **scatter
    )
    yield call(
        "map_sharpness", map_sharpness, points=np.random.default_rng(1).uniform(0, 2, (2000, 3)).astype(np.float32)
    )
    path = se3.exp(np.random.default_rng(1).normal(size=(5, 6)))
    yield call("align", align, T_estimate=path, T_reference=path)


def record_calls():
    noise = {"gyro": np.zeros((2, 3)), "accel": np.zeros((2, 3))}
    yield call("ImuBatch", ImuBatch, {"received_ns": 0}, stamps_ns=STAMPS, **noise)
    scan = {"points": CLOUD, "offsets_ns": np.zeros(40, np.int32), "intensity": CLOUD[:, 0].copy()}
    yield call("Scan", Scan, {"stamp_ns": 0, "header_stamp_ns": 0, "received_ns": 0, "end_ns": 0}, **scan)
    yield call("Trajectory", Trajectory, stamps_ns=STAMPS, T_frame_body=POSES)
    yield call("Rig", Rig, {"source": "test"}, T_imu_lidar=np.eye(4))
    fix = {"stamp_ns": 0, "received_ns": 0, "latitude_deg": 0.0, "longitude_deg": 0.0, "altitude": 0.0}
    yield call("GnssFix", GnssFix, fix, covariance_enu=np.eye(3))


CALLS = [*lie_calls(), *cloud_calls(), *record_calls()]
OPTIONAL = {("GlobalMap.insert", "intensity"), ("linearize", "before_end")}
OPTIONAL |= {("Scan", "intensity"), ("GnssFix", "covariance_enu")}


def wrong_arrays(good):
    """Arrays that differ from a good one in rank, in a length, in kind, in memory or in value, by name."""
    yield "nothing", None
    yield "text", "abc"
    yield "texts", np.full(good.shape, "1.0")
    yield "objects", good.astype(object)
    yield "ragged", [[1.0, 2.0], [3.0]]
    yield "a dictionary", {"x": good}
    yield "complex", good.astype(np.complex128)
    yield "truth values", good.astype(bool)
    yield "a number", good.dtype.type(1)
    yield "one axis more", good[None]
    yield "one axis less", good[0] if good.ndim else good
    yield "two axes more", good[None, None]
    yield "no axis", good.reshape(-1)[:1].reshape(())
    yield "one more at the end", np.concatenate([good, good[..., :1]], axis=-1)
    yield "one less at the end", good[..., :-1].copy()
    yield "one more in front", np.concatenate([good, good[:1]], axis=0)
    yield "none in front", good[:0].copy()
    yield "nothing at the end", good[..., :0].copy()
    yield "empty", np.zeros(0, good.dtype)
    yield "long", np.zeros(1000, good.dtype)
    for other in (np.float16, np.float32, np.float64, np.int32, np.int64, np.uint8, np.dtype(">f8"), np.dtype(">i8")):
        yield f"dtype {np.dtype(other)}", good.astype(other)
    yield "a list", good.tolist()
    yield "every second", np.repeat(good, 2, axis=0)[::2]
    yield "columns first", np.asfortranarray(good)
    yield "read-only", np.frombuffer(good.tobytes(), good.dtype).reshape(good.shape)
    if good.dtype.kind == "f":
        for value in (np.nan, np.inf, -np.inf, 1e30):
            yield f"all {value}", np.full_like(good, value)
            one = good.copy()
            one.flat[0] = value
            yield f"one {value}", one
    else:
        yield "the largest integer", np.full_like(good, np.iinfo(good.dtype).max)
        yield "the smallest integer", np.full_like(good, np.iinfo(good.dtype).min)


@pytest.mark.parametrize("case", CALLS, ids=lambda case: case.name)
def test_wrong_arrays_raise_errors_of_the_family_that_name_the_argument(case):
    case.function(**case.arrays, **case.rest)
    for argument, good in case.arrays.items():
        for kind, value in wrong_arrays(good):
            arrays = {**case.arrays, argument: value}
            with warnings.catch_warnings(), contextlib.suppress(DataError), np.errstate(all="ignore"):
                warnings.simplefilter("ignore", RuntimeWarning)
                try:
                    case.function(**arrays, **case.rest)
                except HeliographError:
                    raise
                except Exception as error:  # any other is what this test is about
                    pytest.fail(f"{case.name}({argument}: {kind}) raises {type(error).__name__}: {error}")


NEVER = ("text", "texts", "objects", "ragged", "a dictionary", "complex")


@pytest.mark.parametrize("case", CALLS, ids=lambda case: case.name)
def test_what_is_no_array_of_numbers_is_refused_by_name(case):
    for argument, good in case.arrays.items():
        for kind, value in wrong_arrays(good):
            if kind in NEVER or (kind == "nothing" and (case.name, argument) not in OPTIONAL):
                with pytest.raises(DataError, match=r"convert it explicitly|makes no array") as caught:
                    case.function(**{**case.arrays, argument: value}, **case.rest)
                message = str(caught.value)
                assert "\n" not in message
                assert argument in message or case.name == f"{case.name.partition('.')[0]}.exp"


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (voxel_downsample, (np.zeros((5, 3)), 0.4), r"points has dtype float64, expected \(N, 3\) float32"),
        (
            voxel_downsample,
            (np.zeros((5, 2), np.float32), 0.4),
            r"points has shape \(5, 2\), expected \(N, 3\) float32",
        ),
        (voxel_downsample, (CLOUD, 0.0), "leaf is 0.0, expected an edge above 0 m"),
        (so3.log, (np.zeros((5, 2)),), r"R has shape \(5, 2\), expected real numbers \(\.\.\., 3, 3\)"),
        (so3.exp, (None,), "phi has dtype object, expected real numbers"),
        (se3.compose, (POSES, np.tile(np.eye(4), (3, 1, 1))), r"T_a_b and T_b_c have shapes .* broadcast"),
        (
            lambda *arrays: VoxelMap().insert(*arrays),
            (CLOUD, np.full((4, 4), np.nan)),
            "T_odom_body holds 16 values that are not finite",
        ),
        (interpolate_se3, (STAMPS * 1.5, POSES, STAMPS), "stamps_ns has dtype float64, expected whole nanoseconds"),
    ],
)
def test_messages_name_argument_what_came_and_what_is_wanted(function, arguments, message):
    with pytest.raises(DataError, match=message):
        function(*arguments)


def test_points_that_are_not_finite_are_as_if_not_there():
    holed = np.concatenate([CLOUD, np.full((3, 3), np.nan, np.float32), np.full((2, 3), np.inf, np.float32)])
    assert np.array_equal(voxel_downsample(holed, 0.4), voxel_downsample(CLOUD, 0.4))
    assert np.array_equal(range_gate(holed, 0.0, 9.0), range_gate(CLOUD, 0.0, 9.0))
    assert np.array_equal(filled_map().planes_at(holed.astype(float), gate=0.5).source[40:], np.zeros(5))
    with_holes, whole = (linearize(filled_map(), cloud, np.eye(4), SETTINGS) for cloud in (holed, CLOUD))
    assert np.array_equal(with_holes.information, whole.information)
    assert with_holes.matches == whole.matches
    averaged = [GlobalMap(0.1), GlobalMap(0.1)]
    for cloud, global_map in zip((holed, CLOUD), averaged, strict=True):
        global_map.insert(cloud, None, np.eye(4))
    assert np.array_equal(averaged[0].points(), averaged[1].points())
