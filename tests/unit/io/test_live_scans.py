"""A driver's clouds and samples, outside any recording."""

from types import SimpleNamespace

import numpy as np
import pytest

from heliograph.config import InputConfig
from heliograph.errors import ConfigError, DataError
from heliograph.io import LiveScans, cloud_of_array, cloud_of_message, sample_of_message

OUSTER = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4"), ("ring", "<u2"), ("intensity", "<f4")])
CODES = {"f4": 7, "u4": 6, "u2": 4}


def points(seed=0, count=400):
    rng = np.random.default_rng(seed)
    out = np.zeros(count, OUSTER)
    for axis in "xyz":
        out[axis] = rng.uniform(1.0, 5.0, count)
    out["t"] = np.linspace(0, 99_000_000, count).astype(np.uint32)
    out["ring"], out["intensity"] = np.arange(count) % 16, 7.0
    return out


def header(stamp_ns, ros1=False):
    names = ("secs", "nsecs") if ros1 else ("sec", "nanosec")
    stamp = SimpleNamespace(**dict(zip(names, divmod(stamp_ns, 1_000_000_000), strict=True)))
    return SimpleNamespace(stamp=stamp, frame_id="os")


def message(array, stamp_ns, **changes):
    fields = [
        SimpleNamespace(
            name=name, offset=array.dtype.fields[name][1], datatype=CODES[array.dtype[name].str[1:]], count=1
        )
        for name in array.dtype.names
    ]
    made = {
        "header": header(stamp_ns), "height": 1, "width": len(array), "fields": fields, "is_bigendian": False,
        "point_step": array.dtype.itemsize, "row_step": array.nbytes, "data": np.frombuffer(array.tobytes(), np.uint8),
    }  # fmt: skip
    return SimpleNamespace(**made | changes)


STAMP = 1_700_000_000_000_000_000


def test_messages_and_arrays_give_the_same_scans():
    live, arrays = LiveScans(), LiveScans()
    found, expected = [], []
    for k in range(7):
        cloud, stamp = points(k), STAMP + k * 100_000_000
        found.append(live.add(cloud_of_message(message(cloud, stamp), received_ns=stamp + 120_000_000)))
        expected.append(arrays.add(cloud_of_array(cloud, stamp_ns=stamp, received_ns=stamp + 120_000_000)))
    assert [len(scans) for scans in found] == [0, 0, 0, 0, 5, 1, 1]
    flat = [scan for scans in found for scan in scans]
    for k, (a, b) in enumerate(zip(flat, [scan for scans in expected for scan in scans], strict=True)):
        assert a.points.tobytes() == b.points.tobytes()
        np.testing.assert_array_equal(a.offsets_ns, points(k)["t"])
        np.testing.assert_array_equal(a.ring, points(k)["ring"])
        assert (a.stamp_ns, a.frame_id, b.frame_id) == (STAMP + k * 100_000_000, "os", "lidar")
        assert a.has_point_times
    assert any(inference.value == "t" for inference in live.inferences)


def test_a_stream_that_ends_early_loses_nothing():
    live = LiveScans(probe=3)
    assert live.add(cloud_of_array(points(), stamp_ns=STAMP)) == []
    assert len(live.finish()) == 1
    assert live.finish() == []


def test_settings_overrule_and_wrong_clouds_are_refused():
    with pytest.raises(ConfigError, match="no field 'time'"):
        LiveScans(InputConfig(point_time_field="time"), probe=1).add(cloud_of_array(points(), stamp_ns=STAMP))
    with pytest.raises(DataError, match="named fields"):
        cloud_of_array(np.zeros((5, 3)), stamp_ns=STAMP)
    with pytest.raises(DataError, match="bytes for 1 x 400 points"):
        cloud_of_message(message(points(), STAMP, data=np.zeros(10, np.uint8)))
    flat = points()[["t", "ring"]]
    with pytest.raises(DataError, match="without field 'x'"):
        LiveScans(probe=1).add(cloud_of_array(flat, stamp_ns=STAMP))


@pytest.mark.parametrize("ros1", [False, True])
def test_samples_of_either_ros(ros1):
    def vector(x, y, z):
        return SimpleNamespace(x=x, y=y, z=z)

    sample = SimpleNamespace(
        header=header(STAMP + 5, ros1), angular_velocity=vector(1, 2, 3), linear_acceleration=vector(4.0, 5.0, 9.8)
    )
    batch = sample_of_message(sample)
    assert batch.stamps_ns.tolist() == [STAMP + 5]
    np.testing.assert_array_equal(batch.gyro, [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(batch.accel, [[4.0, 5.0, 9.8]])
    assert (batch.received_ns, batch.frame_id) == (STAMP + 5, "os")
