"""The native point decoder against its slow twin, for every column type, spacing and shape."""

import itertools

import numpy as np
import pytest
from tests.reference.decode import decode_slowly, offsets_slowly

from heliograph import _core
from heliograph.errors import DataError
from heliograph.io.inference.scans import PointTiming, to_scan, valid_points
from heliograph.io.raw import RawCloud

AXES = ("f4", "f8", "i2", "i4")
TIMES = ("f4", "f8", "u1", "u2", "u4", "i4")
RINGS = ("u1", "i1", "u2", "i2", "u4", "i4")


def columns_of(rng, shape, *, axis="f4", time="u4", intensity="f4", ring="u2"):
    """Columns of random values in packed records, so that strides split elements."""
    fields = [("x", axis), ("y", axis), ("z", axis), ("t", time), ("intensity", intensity), ("ring", ring)]
    records = np.zeros(shape, np.dtype(fields))
    for name in "xyz":
        records[name] = rng.integers(-300, 300, shape) * (1 if axis[0] == "i" else 0.125)
    for name in ("t", "intensity", "ring"):
        records[name] = rng.integers(0, 100, shape)
    spoiled = rng.random((3, *shape)) < 0.1
    for bad, name in zip(spoiled, "xyz", strict=True):
        records[name][bad] = 0 if axis[0] == "i" else rng.choice([np.nan, np.inf, -np.inf, 0.0], int(bad.sum()))
    lost = rng.random(shape) < 0.2
    for name in "xyz":
        records[name][lost] = 0
    return {name: records[name] for name, _ in fields}


def cloud_of(columns):
    return RawCloud(topic="/points", received_ns=5, stamp_ns=1_000, frame_id="", columns=columns)


@pytest.mark.parametrize(
    ("axis", "time", "ring", "shape"),
    [(a, TIMES[k % 6], RINGS[k % 6], s) for k, (a, s) in enumerate(itertools.product(AXES, [(700,), (3, 300), (0,)]))],
)
def test_decoder_equals_the_slow_twin(axis, time, ring, shape):
    columns = columns_of(np.random.default_rng(7), shape, axis=axis, time=time, ring=ring)
    found = _core.decode_points(*(columns[n] for n in ("x", "y", "z", "t", "intensity", "ring")))
    points, kept, times, first, intensity, rings = found
    slow_points, slow_kept, taken = decode_slowly(columns)
    assert points.dtype == np.float32
    assert rings.dtype == np.uint16
    np.testing.assert_array_equal(points, np.array(slow_points, np.float32).reshape(-1, 3))
    assert kept.tolist() == slow_kept
    np.testing.assert_array_equal(times, np.array(taken["t"], np.float64))
    np.testing.assert_array_equal(intensity, np.array(taken["intensity"], np.float32))
    np.testing.assert_array_equal(rings, np.array(taken["ring"], np.int64).astype(np.uint16))
    assert first == min(taken["t"], default=np.inf)


def test_columns_that_are_absent_stay_absent():
    columns = columns_of(np.random.default_rng(1), (10,))
    found = _core.decode_points(columns["x"], columns["y"], columns["z"], None, None, None)
    assert found[2] is None
    assert found[4] is None
    assert found[5] is None


def test_columns_of_other_shapes_or_types_are_refused():
    x = np.zeros(4, np.float32)
    with pytest.raises(ValueError, match="same"):
        _core.decode_points(x, x, x[:2], None, None, None)
    with pytest.raises(ValueError, match="same"):
        _core.decode_points(x, x, x.reshape(2, 2), None, None, None)
    with pytest.raises(ValueError, match="native"):
        _core.decode_points(x.astype(">f4"), x, x, None, None, None)


def test_foreign_byte_order_and_long_integers_give_the_same_scan():
    columns = columns_of(np.random.default_rng(3), (4, 50))
    timing = PointTiming(method="field", field="t", reference="absolute")
    plain = to_scan(cloud_of(columns), timing)
    swapped = {name: column.astype(column.dtype.newbyteorder(">")) for name, column in columns.items()}
    epoch = 1_750_000_000_123_456_789
    swapped["t"] = columns["t"].astype(np.int64) + epoch
    other = to_scan(cloud_of(swapped), timing)
    for name in ("points", "offsets_ns", "intensity", "ring"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(other, name))
    assert other.stamp_ns - plain.stamp_ns == epoch


def test_epoch_in_seconds_keeps_every_digit_that_a_double_has():
    # A double holds 1.75e9 s to 2^-22 s = 238.4 ns; the same instant in nanoseconds as a double only to 256 ns.
    columns = {name: np.ones(2, np.float32) for name in "xyz"}
    columns["t"] = 1_750_000_000 + np.array([3.0, 3.0 + 2**17]) * 2**-22
    scan = to_scan(cloud_of(columns), PointTiming(method="field", field="t", ns_per_unit=1e9, reference="absolute"))
    assert scan.stamp_ns == 1_750_000_000_000_000_715  # 3 * 238.42 ns after the second
    assert scan.offsets_ns.tolist() == [0, 31_250_000]


def test_offsets_equal_the_slow_twin():
    times = np.array([0.5, 0.0, 1.0, 2.5e-9, 3.5e-9, 3.0, np.nan, np.inf, -np.inf, 2.0])
    offsets, largest, outside = _core.sweep_offsets(times, 0.0, 1e9, 2_000_000_000.0)
    slow = offsets_slowly(times, 0.0, 1e9, 2_000_000_000.0)
    assert offsets.tolist() == [0 if offset is None else offset for offset in slow]
    assert largest == 2_000_000_000
    assert outside == slow.count(None)


def test_valid_points_names_them_only_where_some_are_lost():
    columns = {name: np.arange(1, 5, dtype=np.float32) for name in "xyz"}
    points, kept = valid_points(cloud_of(columns))
    assert kept is None
    assert points.tolist() == [[v, v, v] for v in range(1, 5)]
    columns["y"] = np.array([1, np.nan, 3, 4], np.float32)
    points, kept = valid_points(cloud_of(columns))
    assert kept is not None
    assert kept.tolist() == [0, 2, 3]
    with pytest.raises(DataError, match="without field 'z'"):
        valid_points(cloud_of({name: columns[name] for name in "xy"}))
