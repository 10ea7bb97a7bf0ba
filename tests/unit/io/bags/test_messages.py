"""The fast decoders against rosbags' generic deserialiser and against an obvious slow twin."""

import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.bags import (
    CLOUD,
    DATATYPES,
    FIX,
    IMU,
    LIVOX_PACKAGES,
    STORES,
    T0,
    TF,
    VELODYNE,
    cloud_message,
    fix_message,
    imu_message,
    livox_message,
    point_dtype,
    sweep,
    tf_message,
)

from heliograph.errors import DataError
from heliograph.io.bags.messages import DECODERS, point_columns

LIVOX = point_dtype(
    [
        ("offset_time", "<u4", 0),
        ("x", "<f4", 4),
        ("y", "<f4", 8),
        ("z", "<f4", 12),
        ("reflectivity", "u1", 16),
        ("tag", "u1", 17),
        ("line", "u1", 18),
    ],
    20,
)
ENCODINGS = {1: "ros1", 2: "cdr"}


def serialise(ros, message, kind):
    store = STORES[ros]
    data = store.serialize_ros1(message, kind) if ros == 1 else store.serialize_cdr(message, kind)
    return memoryview(bytes(data))


def decode(ros, kind, message):
    return DECODERS[kind]("/topic", T0 + 5, serialise(ros, message, kind), ENCODINGS[ros])


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("frame", ["", "a", "lidar", "a/long/frame_name"])  # every alignment of what follows
def test_cloud_columns_are_the_message_s(ros, frame):
    points = sweep(VELODYNE)
    points["ring"] = np.arange(len(points))
    (cloud,) = decode(ros, CLOUD, cloud_message(STORES[ros], points, T0 + 123, frame))
    assert cloud.stamp_ns == T0 + 123
    assert cloud.received_ns == T0 + 5
    assert cloud.frame_id == frame
    assert list(cloud.columns) == list(VELODYNE.names)
    for name in VELODYNE.names:
        assert np.array_equal(cloud.columns[name], points[name])


def test_cloud_columns_are_views_of_the_payload():
    payload = serialise(2, cloud_message(STORES[2], sweep(VELODYNE), T0), CLOUD)
    (cloud,) = DECODERS[CLOUD]("/topic", T0, payload, "cdr")
    whole = np.frombuffer(payload, np.uint8)
    assert all(np.shares_memory(column, whole) for column in cloud.columns.values())


def test_big_endian_cloud_reads_the_same_numbers():
    big = point_dtype([("x", ">f8", 0), ("y", ">f4", 8), ("z", ">f4", 12), ("t", ">u4", 16)], 20)
    points = sweep(big)
    points["t"] = np.arange(len(points)) * 1000
    (cloud,) = decode(2, CLOUD, cloud_message(STORES[2], points, T0))
    for name in big.names:
        assert np.array_equal(cloud.columns[name], points[name])


def test_big_endian_cdr_is_read():
    message = cloud_message(STORES[2], sweep(VELODYNE, 5), T0)
    store = STORES[2]
    payload = memoryview(bytes(store.serialize_cdr(message, CLOUD, little_endian=False)))
    (cloud,) = DECODERS[CLOUD]("/topic", T0, payload, "cdr")
    assert cloud.stamp_ns == T0
    assert np.array_equal(cloud.columns["x"], sweep(VELODYNE, 5)["x"])


@pytest.mark.parametrize("padding", [0, 7])
def test_organised_cloud_keeps_its_shape_through_row_padding(padding):
    points = sweep(VELODYNE, 24).reshape(4, 6)
    (cloud,) = decode(2, CLOUD, cloud_message(STORES[2], points, T0, row_padding=padding))
    assert cloud.columns["x"].shape == (4, 6)
    assert np.array_equal(cloud.columns["time"], points["time"])
    assert np.array_equal(cloud.columns["z"], points["z"])


def test_empty_cloud_has_empty_columns():
    (cloud,) = decode(2, CLOUD, cloud_message(STORES[2], sweep(VELODYNE, 0), T0))
    assert {column.size for column in cloud.columns.values()} == {0}


def test_cloud_shorter_than_its_header_says_is_refused():
    message = cloud_message(STORES[2], sweep(VELODYNE, 10), T0)
    message = type(message)(
        **{**{f: getattr(message, f) for f in message.__dataclass_fields__ if f != "__msgtype__"}, "width": 11}
    )
    with pytest.raises(DataError, match="1 x 11 points of 22 bytes"):
        decode(2, CLOUD, message)


def test_field_beyond_its_point_is_refused():
    with pytest.raises(DataError, match="'x' ends at byte 8 of a 6-byte point"):
        point_columns(memoryview(bytes(60)), (("x", 4, 7, 1),), "<", (1, 10), (60, 6))


@pytest.mark.parametrize(("height", "width"), [(1, 2**32 - 1), (16, 2**32 - 1), (2**32 - 1, 2**32 - 1)])
@pytest.mark.parametrize("step", [2**31, 2**32 - 1])
def test_clouds_whose_size_no_integer_holds_are_refused(height, width, step):
    """The way to the last point wraps around 2^64 to somewhere inside the data, and far outside is what was read."""
    with pytest.raises(DataError, match="bytes for"):
        point_columns(memoryview(bytes(64)), (("x", 0, 7, 1),), "<", (height, width), (width * step, step))


@st.composite
def random_clouds(draw):
    names = draw(st.permutations(["x", "y", "z", "t", "i", "ring"]))[: draw(st.integers(1, 6))]
    order = draw(st.sampled_from("<>"))
    fields, at = [], 0
    for name in names:
        kind = draw(st.sampled_from(sorted(DATATYPES)))
        at += draw(st.integers(0, 5))
        fields.append((name, at, kind))
        at += int(kind[1])
    step = at + draw(st.integers(0, 7))
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    row_step = width * step + draw(st.integers(0, 9))
    data = draw(st.binary(min_size=height * row_step, max_size=height * row_step))
    return fields, order, (height, width), (row_step, step), data


def slow_columns(fields, order, shape, steps, data):
    """One value at a time, from the definition of the message."""
    codes = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
    (height, width), (row_step, point_step) = shape, steps
    columns = {}
    for name, offset, kind in fields:
        rows = [
            [
                struct.unpack_from(order + codes[kind], data, v * row_step + u * point_step + offset)[0]
                for u in range(width)
            ]
            for v in range(height)
        ]
        columns[name] = rows[0] if height == 1 else rows
    return columns


@given(random_clouds())
@settings(max_examples=150, deadline=None, derandomize=True)
@example((([("x", 1, "f4")]), ">", (1, 1), (11, 11), b"\x00\x7f\x80\x00\x01\x00\x00\x00\x00\x00\x00"))
def test_point_columns_equal_the_slow_twin(case):
    fields, order, shape, steps, data = case
    given_fields = tuple((name, offset, DATATYPES[kind], 1) for name, offset, kind in fields)
    fast = point_columns(memoryview(data), given_fields, order, shape, steps)
    slow = slow_columns(fields, order, shape, steps, data)
    assert list(fast) == list(slow)
    for name in slow:
        with np.errstate(invalid="ignore"):  # a signalling NaN among the random bytes warns when it is converted
            values = fast[name].astype(np.float64)
        assert np.array_equal(values, np.array(slow[name], np.float64), equal_nan=True)


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("package", LIVOX_PACKAGES)
@pytest.mark.parametrize("n", [0, 1, 50])
def test_livox_message_is_read_under_every_name(ros, package, n):
    points = sweep(LIVOX, n)
    points["offset_time"] = np.arange(n) * 1000
    points["line"] = np.arange(n) % 4
    kind = f"{package}/msg/CustomMsg"
    (cloud,) = decode(ros, kind, livox_message(STORES[ros], package, points, T0))
    assert cloud.layout == "livox/CustomMsg"
    assert cloud.base_time_ns == cloud.stamp_ns == T0
    for name in LIVOX.names:
        assert np.array_equal(cloud.columns[name], points[name])


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("frame", ["", "imu", "imu_link"])
def test_imu_sample_is_read(ros, frame):
    (sample,) = decode(ros, IMU, imu_message(STORES[ros], T0 + 77, (0.1, -0.2, 0.3), (1.0, 2.0, 9.7), frame))
    assert (sample.stamp_ns, sample.frame_id) == (T0 + 77, frame)
    assert sample.gyro == (0.1, -0.2, 0.3)
    assert sample.accel == (1.0, 2.0, 9.7)
    assert not sample.has_orientation


@pytest.mark.parametrize("ros", [1, 2])
def test_fix_is_read(ros):
    (fix,) = decode(ros, FIX, fix_message(STORES[ros], T0, latitude=-33.25))
    assert (fix.latitude_deg, fix.longitude_deg, fix.altitude, fix.valid) == (-33.25, 11.6, 520.0, True)
    assert np.array_equal(fix.covariance_enu, np.diag([1.0, 2.0, 3.0]))


@pytest.mark.parametrize("ros", [1, 2])
def test_transforms_are_read(ros):
    half = np.sqrt(0.5)
    message = tf_message(
        STORES[ros],
        [
            ("base", "imu", (1.0, 2.0, 3.0), (0.0, 0.0, half, half)),
            ("/imu", "lidar", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)),
        ],
    )
    first, second = decode(ros, TF, message)
    assert (first.parent, first.child) == ("base", "imu")
    assert (second.parent, second.child) == ("imu", "lidar")
    # A quarter turn about z takes x to y.
    assert np.allclose(first.T_parent_child @ [1.0, 0.0, 0.0, 1.0], [1.0, 3.0, 3.0, 1.0])
