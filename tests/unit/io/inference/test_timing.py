"""Per-point times: every layout of the table gives the same instants, and contradictions are noticed."""

from dataclasses import replace

import numpy as np
import pytest
from tests.bags import PERIOD, T0, point_dtype, sweep

from heliograph.config import InputConfig
from heliograph.errors import ConfigError, DataError
from heliograph.io.inference.layouts import LAYOUTS, find_layout
from heliograph.io.inference.scans import PointTiming, azimuth_offsets, to_scan
from heliograph.io.inference.timing import infer_timing
from heliograph.io.raw import RawCloud

XYZ = [("x", "<f4", 0), ("y", "<f4", 4), ("z", "<f4", 8)]
XYZI = [*XYZ, ("intensity", "<f4", 12)]
N = 400
SPAN = 99_000_000
OFFSETS = (np.arange(N) * SPAN // (N - 1)).astype(np.int64)


def raw(points, stamp_ns, received_ns=None, layout="PointCloud2"):
    columns = {name: points[name] for name in points.dtype.names}
    received_ns = stamp_ns + PERIOD if received_ns is None else received_ns
    return RawCloud(
        topic="/points", received_ns=received_ns, stamp_ns=stamp_ns, frame_id="lidar", columns=columns, layout=layout
    )


def clouds_of(fields, step, name, convert, *, stamp_shift=0, layout="PointCloud2", count=5):
    """``convert(start_ns, offsets)`` gives the raw times; the sweep starts at T0 + k PERIOD."""
    dtype = point_dtype(fields, step)
    found = []
    for k in range(count):
        start = T0 + k * PERIOD
        points = sweep(dtype, N, seed=k)
        points[name] = convert(start, OFFSETS)
        found.append(raw(points, start + stamp_shift, layout=layout))
    return found


# Fixtures of the drivers' own messages: fields at the offsets that the driver writes (see layouts.py for the sources).
OUSTER = [
    *XYZ,
    ("intensity", "<f4", 16),
    ("t", "<u4", 20),
    ("reflectivity", "<u2", 24),
    ("ring", "<u2", 26),
    ("ambient", "<u2", 28),
    ("range", "<u4", 32),
]
VELODYNE = [*XYZI, ("ring", "<u2", 16), ("time", "<f4", 18)]
HESAI = [*XYZI, ("ring", "<u2", 16), ("timestamp", "<f8", 18)]
ROBOSENSE = [*XYZI, ("ring", "<u2", 16), ("timestamp", "<f8", 24)]
LIVOX = [*XYZI, ("tag", "u1", 16), ("line", "u1", 17), ("timestamp", "<f8", 18)]
CUSTOM = [
    ("offset_time", "<u4", 0),
    ("x", "<f4", 4),
    ("y", "<f4", 8),
    ("z", "<f4", 12),
    ("reflectivity", "u1", 16),
    ("tag", "u1", 17),
    ("line", "u1", 18),
]
FIXTURES = {
    "ouster": (OUSTER, 48, "t", lambda _, o: o, 0, "PointCloud2"),
    "velodyne": (VELODYNE, 22, "time", lambda _, o: o * 1e-9, 0, "PointCloud2"),
    "velodyne negative": (VELODYNE, 22, "time", lambda _, o: (o - SPAN) * 1e-9, SPAN, "PointCloud2"),
    "velodyne middle": (VELODYNE, 22, "time", lambda _, o: (o - SPAN // 2) * 1e-9, SPAN // 2, "PointCloud2"),
    "hesai": (HESAI, 26, "timestamp", lambda s, o: (s + o) * 1e-9, 0, "PointCloud2"),
    "robosense": (ROBOSENSE, 32, "timestamp", lambda s, o: (s + o) * 1e-9, SPAN, "PointCloud2"),
    "livox custom": (CUSTOM, 20, "offset_time", lambda _, o: o, 0, "livox/CustomMsg"),
    "livox pointcloud2": (LIVOX, 26, "timestamp", lambda s, o: (s + o).astype(np.float64), 0, "PointCloud2"),
}
TABLE_ROW = {
    "ouster": "ouster",
    "velodyne": "velodyne",
    "velodyne negative": "velodyne",
    "velodyne middle": "velodyne",
    "hesai": "hesai",
    "robosense": "hesai",
    "livox custom": "livox-custom",
    "livox pointcloud2": "livox-pointcloud2",
}
MEANINGS = {"velodyne negative": "its end", "robosense": "its end", "velodyne middle": "its middle"}


@pytest.mark.parametrize("name", FIXTURES)
def test_layout_is_recognised_and_gives_the_true_instants(name):
    fields, step, field, convert, shift, message = FIXTURES[name]
    clouds = clouds_of(fields, step, field, convert, stamp_shift=shift, layout=message)
    assert find_layout(clouds[0].layout, clouds[0].columns).name == TABLE_ROW[name]
    result = infer_timing(clouds, InputConfig())
    assert result.events == ()
    meaning = next(i.value for i in result.inferences if i.name == "scan stamp")
    assert meaning.startswith(MEANINGS.get(name, "the sweep's start"))
    for k, cloud in enumerate(clouds):
        scan = to_scan(cloud, result.timing)
        instants = scan.stamp_ns + scan.offsets_ns.astype(np.int64)
        assert scan.has_point_times
        assert scan.header_stamp_ns == cloud.stamp_ns
        assert np.abs(instants - (T0 + k * PERIOD + OFFSETS)).max() <= 500  # a double of this epoch resolves 256 ns
        assert scan.end_ns == scan.stamp_ns + int(scan.offsets_ns.max())


def test_every_row_of_the_table_has_a_fixture():
    assert set(TABLE_ROW.values()) == {layout.name for layout in LAYOUTS}


@pytest.mark.parametrize(("unit", "scale"), [("s", 1e-9), ("ms", 1e-6), ("us", 1e-3), ("ns", 1.0)])
def test_unit_is_told_by_the_span_of_a_sweep(unit, scale):
    fields = [*XYZ, ("time_offset", "<f8", 12)]
    result = infer_timing(clouds_of(fields, 20, "time_offset", lambda _, o: o * scale), InputConfig())
    scan = to_scan(clouds_of(fields, 20, "time_offset", lambda _, o: o * scale)[0], result.timing)
    assert next(i.value for i in result.inferences if i.name == "point time unit") == unit
    assert np.abs(scan.offsets_ns - OFFSETS).max() <= 1


def test_nanoseconds_in_the_seconds_field_of_velodyne_are_caught():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: o)
    result = infer_timing(clouds, InputConfig())
    assert [e.code for e in result.events] == ["point-time-unit"]
    assert "in ns, not in s" in result.events[0].message
    assert np.abs(to_scan(clouds[0], result.timing).offsets_ns - OFFSETS).max() <= 8  # single precision


def test_absolute_times_in_a_relative_field_are_used_and_reported():
    clouds = clouds_of(OUSTER, 48, "t", lambda s, o: (s - T0 + o) // 1000 + 4_000_000_000)
    result = infer_timing(clouds, InputConfig())
    assert {"point-time-reference", "point-clock", "point-time-unit"} == {e.code for e in result.events}
    assert np.abs(to_scan(clouds[1], result.timing).offsets_ns - OFFSETS).max() <= 1000


def test_overridden_unit_is_obeyed():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: o * 1e-9)
    result = infer_timing(clouds, InputConfig(point_time_unit="ms"))
    inference = next(i for i in result.inferences if i.name == "point time unit")
    assert (inference.value, inference.source) == ("ms", "override")
    assert to_scan(clouds[0], result.timing).offsets_ns.max() == pytest.approx(SPAN * 1e-3, rel=1e-3)


@pytest.mark.parametrize(("reference", "shift"), [("start", 0), ("middle", SPAN // 2), ("end", SPAN)])
def test_overridden_reference_moves_the_sweep(reference, shift):
    clouds = clouds_of(OUSTER, 48, "t", lambda _, o: o, stamp_shift=shift)
    result = infer_timing(clouds, InputConfig(point_time_reference=reference))
    scan = to_scan(clouds[2], result.timing)
    assert abs(scan.stamp_ns - (T0 + 2 * PERIOD)) <= 1
    assert scan.header_stamp_ns == T0 + 2 * PERIOD + shift


def test_start_reference_overrules_negative_times():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: (o - SPAN) * 1e-9)  # stamped at the start all the same
    scan = to_scan(clouds[0], infer_timing(clouds, InputConfig(point_time_reference="start")).timing)
    assert abs(scan.stamp_ns - T0) < 20
    assert scan.offsets_ns.min() == 0


def test_field_that_does_not_exist_is_refused_with_the_valid_ones():
    with pytest.raises(ConfigError, match=r"intensity.*did you mean 'time'"):
        infer_timing(clouds_of(VELODYNE, 22, "time", lambda _, o: o * 1e-9), InputConfig(point_time_field="tyme"))


def test_absolute_times_in_another_clock_keep_their_spacing():
    clouds = clouds_of(HESAI, 26, "timestamp", lambda s, o: (s - T0 + o) * 1e-9 + 1234.5)
    result = infer_timing(clouds, InputConfig())
    assert [e.code for e in result.events] == ["point-clock"]
    scan = to_scan(clouds[1], result.timing)
    assert scan.stamp_ns == T0 + PERIOD
    assert np.abs(scan.offsets_ns - OFFSETS).max() <= 1


def writable(cloud):
    """A cloud's columns, copied: those of the record itself are read-only."""
    return {name: values.copy() for name, values in cloud.columns.items()}


def test_lost_first_points_do_not_move_a_sweep_that_starts_at_its_stamp():
    clouds = clouds_of(OUSTER, 48, "t", lambda _, o: o)
    points = writable(clouds[0])
    for axis in "xyz":
        points[axis][:100] = 0.0
    clouds[0] = replace(clouds[0], columns=points)
    scan = to_scan(clouds[0], infer_timing(clouds, InputConfig()).timing)
    assert scan.stamp_ns == T0
    assert len(scan) == N - 100
    assert np.array_equal(scan.offsets_ns, OFFSETS[100:])


def test_invalid_points_are_dropped_and_do_not_count_for_the_end():
    clouds = clouds_of(OUSTER, 48, "t", lambda _, o: o)
    columns = writable(clouds[0])
    columns["x"][-1] = np.nan
    columns["y"][-2] = np.inf
    for axis in "xyz":
        columns[axis][-3] = 0.0
    clouds[0] = replace(clouds[0], columns=columns)
    scan = to_scan(clouds[0], infer_timing(clouds, InputConfig()).timing)
    assert len(scan) == N - 3
    assert np.isfinite(scan.points).all()
    assert scan.end_ns == T0 + OFFSETS[-4]


def test_wild_times_drop_their_points_only():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: o * 1e-9)
    timing = infer_timing(clouds, InputConfig()).timing
    columns = writable(clouds[0])
    columns["time"][7] = 1e6
    columns["time"][8] = np.nan
    scan = to_scan(replace(clouds[0], columns=columns), timing)
    assert len(scan) == N - 2
    assert scan.offsets_ns.max() <= SPAN + 10


@pytest.mark.parametrize("direction", [1, -1])
def test_times_come_from_the_azimuth_where_no_field_has_them(direction):
    dtype = point_dtype(XYZI, 16)
    clouds = []
    for k in range(4):
        points = sweep(dtype, N, seed=k)
        points["y"] *= direction
        clouds.append(raw(points, T0 + k * PERIOD))
    result = infer_timing(clouds, InputConfig())
    scan = to_scan(clouds[0], result.timing)
    assert [e.code for e in result.events] == ["no-point-time"]
    assert result.timing.method == "azimuth"
    assert not scan.has_point_times
    assert np.abs(scan.offsets_ns - np.arange(N) * PERIOD / N).max() < 10_000


def test_sweep_whose_first_beams_are_lost_keeps_the_others_times():
    dtype = point_dtype(XYZI, 16)
    clouds = [raw(sweep(dtype, N, seed=k), T0 + k * PERIOD) for k in range(4)]
    lost = raw(sweep(dtype, N, seed=9)[3:], T0 + 4 * PERIOD)
    scan = to_scan(lost, infer_timing([*clouds, lost], InputConfig()).timing)
    assert np.abs(scan.offsets_ns - np.arange(3, N) * PERIOD / N).max() < 10_000


def test_point_a_hair_before_the_first_azimuth_is_at_the_start():
    points = np.array([[1.0, -1e-4, 0.0], [0.0, 1.0, 0.0]], np.float32)
    timing = PointTiming(method="azimuth", direction=1, azimuth=0.0, period_ns=PERIOD)
    assert azimuth_offsets(points, timing).tolist() == [0, PERIOD // 4]


def test_times_come_from_the_column_of_an_organised_cloud():
    dtype = point_dtype(XYZI, 16)
    clouds = []
    for k in range(3):
        row = sweep(dtype, 128, seed=k)
        grid = np.stack([row, row, row])
        grid["x"][1, :50] = np.nan
        clouds.append(raw(grid, T0 + k * PERIOD))
    result = infer_timing(clouds, InputConfig())
    scan = to_scan(clouds[0], result.timing)
    assert result.timing.method == "columns"
    assert len(scan) == 3 * 128 - 50
    assert np.array_equal(scan.offsets_ns[:128], np.arange(128) * PERIOD // 128)
    assert scan.offsets_ns[128] == 50 * PERIOD // 128


def test_unordered_cloud_without_times_gets_none_and_a_warning():
    dtype = point_dtype(XYZI, 16)
    rng = np.random.default_rng(0)
    clouds = [raw(rng.permutation(sweep(dtype, N, seed=k)), T0 + k * PERIOD) for k in range(3)]
    result = infer_timing(clouds, InputConfig())
    assert result.timing.method == "none"
    assert not to_scan(clouds[0], result.timing).offsets_ns.any()
    assert "fast motion smears" in result.events[0].message


def test_constant_time_field_counts_as_none():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: 0.0 * o)
    result = infer_timing(clouds, InputConfig())
    assert [e.code for e in result.events] == ["no-point-time"]
    assert "'time' is constant" in result.events[0].message


def test_reversed_stamps_are_refused():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: o * 1e-9)[::-1]
    with pytest.raises(DataError, match="run backwards"):
        infer_timing(clouds, InputConfig())


def test_unset_stamps_are_replaced_by_the_times_of_reception():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: o * 1e-9)
    clouds = [raw_with_stamp(c, 0) for c in clouds]
    result = infer_timing(clouds, InputConfig())
    assert result.timing.stamp == "received"
    assert [e.code for e in result.events] == ["no-stamps"]
    assert to_scan(clouds[1], result.timing).header_stamp_ns == clouds[1].received_ns


def raw_with_stamp(cloud, stamp_ns):
    return RawCloud(
        topic=cloud.topic,
        received_ns=cloud.received_ns,
        stamp_ns=stamp_ns,
        frame_id=cloud.frame_id,
        columns=cloud.columns,
    )


def test_scan_received_before_its_sweep_ended_is_questioned():
    clouds = clouds_of(VELODYNE, 22, "time", lambda _, o: o * 1e-9)
    early = [
        RawCloud(
            topic=c.topic,
            received_ns=c.stamp_ns + 20_000_000 + 1000 * k,
            stamp_ns=c.stamp_ns,
            frame_id="l",
            columns=c.columns,
        )
        for k, c in enumerate(clouds)
    ]
    result = infer_timing(early, InputConfig())
    assert [e.code for e in result.events] == ["scan-stamp"]


def test_single_scan_has_the_usual_period():
    result = infer_timing(clouds_of(OUSTER, 48, "t", lambda _, o: o, count=1), InputConfig())
    period = next(i for i in result.inferences if i.name == "sweep period")
    assert (period.source, result.timing.period_ns) == ("default", 100_000_000)


def test_cloud_without_coordinates_is_refused():
    cloud = raw(np.zeros(4, point_dtype([("u", "<f4", 0), ("x", "<f4", 4)], 8)), T0)
    with pytest.raises(DataError, match="without field 'y'"):
        to_scan(cloud, PointTiming())
