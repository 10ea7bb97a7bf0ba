"""Recordings with something wrong: a result with a warning, or one line that says what to do."""

import itertools
import threading
import time

import numpy as np
import pytest
from tests.bags import PERIOD, T0, VELODYNE, Bag, drive, point_dtype, sweep

from heliograph.config import InputConfig
from heliograph.data import ImuBatch, Scan
from heliograph.errors import CalibrationError, DataError, TopicError
from heliograph.io import inspect_recording, open_recording, prefetch


def codes(recording):
    return [event.code for event in recording.events]


def read(bag, tmp_path, config=None, sensors="auto"):
    with open_recording(bag.mcap(tmp_path / "a.mcap"), config, sensors=sensors) as recording:
        return recording, list(recording.stream())


def scans(items):
    return [item for item in items if isinstance(item, Scan)]


def stamps(items):
    return np.concatenate([item.stamps_ns for item in items if isinstance(item, ImuBatch)])


def without(bag, topic):
    return Bag([m for m in bag.messages if m[0] != topic])


def keep(bag, condition):
    return Bag([m for m in bag.messages if condition(m)])


def test_stream_is_in_order_of_reception_with_imu_in_batches(tmp_path):
    _, items = read(drive(), tmp_path)
    received = [item.received_ns for item in items]
    assert received == sorted(received)
    kinds = [type(item) for item in items]
    assert all(a is not ImuBatch or b is not ImuBatch for a, b in itertools.pairwise(kinds))
    assert np.array_equal(stamps(items), T0 + np.arange(80) * 10_000_000)


def test_stream_can_be_read_again(tmp_path):
    path = drive().mcap(tmp_path / "a.mcap")
    with open_recording(path) as recording:
        first, second = list(recording.stream()), list(recording.stream())
        assert recording.tally.lidar.count == 8
    assert [i.received_ns for i in first] == [i.received_ns for i in second]


def test_samples_reach_the_stream_in_si_units(tmp_path):
    bag = without(drive(), "/imu")
    for k in range(100):
        bag.imu(T0 + k * 10_000_000, gyro=(1.0, 0.0, 60.0 * (k == 50)), accel=(0.0, 0.6, 0.8))
    recording, items = read(bag, tmp_path)
    batch = next(item for item in items if isinstance(item, ImuBatch))
    assert np.allclose(batch.accel[0], [0.0, 0.6 * 9.80665, 0.8 * 9.80665])
    assert np.allclose(batch.gyro[0], [np.pi / 180, 0.0, 0.0])
    assert "accel-in-g" in codes(recording)


def test_wrong_topic_lists_the_valid_ones(tmp_path):
    with pytest.raises(TopicError, match=r"/pionts.*/points.*did you mean '/points'"):
        read(drive(), tmp_path, InputConfig(lidar_topic="/pionts"))
    with pytest.raises(TopicError, match="valid ones: /imu"):
        open_recording(tmp_path / "a.mcap", InputConfig(imu_topic="/points"))


def test_recording_without_lidar_is_refused_unless_asked_for(tmp_path):
    with pytest.raises(DataError, match=r"no LiDAR topic among /imu .*--sensors imu"):
        read(without(drive(), "/points"), tmp_path)
    with open_recording(tmp_path / "a.mcap", sensors="imu") as recording:
        assert recording.sensors == {"imu"}
        assert recording.total_scans is None
        assert len(stamps(list(recording.stream()))) == 80


def test_recording_without_imu_is_read_as_lidar_only(tmp_path):
    recording, items = read(without(drive(), "/imu"), tmp_path)
    assert recording.sensors == {"lidar"}
    assert recording.rig.known
    assert len(scans(items)) == 8
    with pytest.raises(DataError, match="no IMU topic"):
        open_recording(tmp_path / "a.mcap", sensors="lidar,imu")


def test_lidar_alone_can_be_asked_for(tmp_path):
    recording, items = read(drive(), tmp_path, sensors="lidar")
    assert recording.sensors == {"lidar"}
    assert {type(item) for item in items} == {Scan}


def test_of_two_lidar_topics_the_one_with_most_points_is_used(tmp_path):
    bag = drive()
    for k in range(8):
        points = sweep(VELODYNE, 100)
        points["time"] = np.linspace(0, 0.09, 100)
        bag.cloud(points, T0 + k * PERIOD, topic="/front")
    recording, items = read(bag, tmp_path)
    assert len(scans(items)[0]) == 400
    assert codes(recording) == ["lidar-topics"]
    assert "/front" in recording.events[0].message
    assert "--lidar-topic" in recording.events[0].message
    with open_recording(tmp_path / "a.mcap", InputConfig(lidar_topic="/front")) as other:
        assert codes(other) == []
        assert len(scans(list(other.stream()))[0]) == 100


def test_of_two_imu_topics_the_one_with_most_samples_is_used(tmp_path):
    bag = drive()
    for k in range(40):
        bag.imu(T0 + k * 20_000_000, topic="/a_slow_imu")
    recording, items = read(bag, tmp_path)
    assert len(stamps(items)) == 80
    assert codes(recording) == ["imu-topics"]


def test_static_transforms_that_come_late_are_found(tmp_path):
    bag = drive(40, tf=False)
    bag.tf(("imu", "lidar", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)), received_ns=T0 + 39 * PERIOD)
    recording, _ = read(bag, tmp_path)
    assert np.allclose(recording.rig.T_imu_lidar[:3, 3], [1.0, 2.0, 3.0])


def test_recording_without_transforms_says_so(tmp_path):
    recording, _ = read(drive(tf=False), tmp_path)
    assert codes(recording) == ["unknown-mount"]
    assert not recording.rig.known


def test_sensor_that_begins_later_than_the_probe_is_not_found(tmp_path):
    late = keep(drive(), lambda m: m[0] != "/points" or m[2] > T0 + 400_000_000)
    assert len(scans(read(late, tmp_path)[1])) == 4
    with pytest.raises(DataError, match="/points holds no usable scan"):
        read(late, tmp_path, InputConfig(max_probe=0.2))


def test_gap_is_counted_and_survived(tmp_path):
    bag = keep(drive(60), lambda m: m[0] == "/tf_static" or not T0 + 2_000_000_000 < m[2] <= T0 + 4_000_000_000)
    recording, items = read(bag, tmp_path)
    assert len(scans(items)) == 40
    assert sorted(codes(recording)) == ["imu-gap", "lidar-gap"]
    assert "2.0" in next(e.message for e in recording.events if e.code == "imu-gap")
    assert recording.tally.lidar.gaps[0][1] == 21 * PERIOD


def test_duplicates_and_rewinds_are_dropped_and_counted(tmp_path):
    bag = drive(20)
    bag.imu(T0 + 500_000_000, received_ns=T0 + 505_000_000)  # again
    bag.imu(T0 + 300_000_000, received_ns=T0 + 805_000_000)  # from the past
    bag.cloud(sweep(VELODYNE), T0 + 5 * PERIOD, received_ns=T0 + 6 * PERIOD + 5)
    recording, items = read(bag, tmp_path)
    assert np.all(np.diff(stamps(items)) > 0)
    assert len(scans(items)) == 20
    imu, lidar = recording.tally.imu, recording.tally.lidar
    assert (imu.duplicates, imu.rewinds, lidar.duplicates, lidar.rewinds) == (1, 1, 1, 0)
    assert {"imu-duplicate", "imu-rewind", "lidar-duplicate"} == set(codes(recording))


def test_late_messages_are_used_and_counted(tmp_path):
    half = T0 + 10 * PERIOD
    bag = Bag(
        [(t, kind, r + 400_000_000 * (t == "/imu" and r > half), make) for t, kind, r, make in drive(20).messages]
    )
    recording, items = read(bag, tmp_path)
    assert len(stamps(items)) == 200
    assert recording.tally.imu.late == 99
    assert codes(recording) == ["imu-late"]


@pytest.mark.parametrize("late_ms", [5, 7])
def test_a_sample_that_came_behind_the_next_is_sorted_in(late_ms, tmp_path):
    """One message that was delivered late is no step of a clock, and no loss."""
    bag = drive(60)
    at = next(k for k, m in enumerate(bag.messages) if m[0] == "/imu" and m[2] > T0 + 2_030_000_000)
    topic, kind, received_ns, make = bag.messages[at]
    late = [
        *bag.messages[:at],
        (topic, kind, received_ns + 10_000_000 + late_ms * 1_000_000, make),
        *bag.messages[at + 1 :],
    ]
    _, whole = read(bag, tmp_path / "whole")
    recording, items = read(Bag(late), tmp_path / "late")
    np.testing.assert_array_equal(stamps(items), stamps(whole))
    assert recording.tally.imu.unordered == 1 and recording.tally.imu.rewinds == 0
    assert [(event.code, event.severity) for event in recording.events] == [("imu-unordered", "info")]


def test_samples_that_are_not_finite_are_dropped(tmp_path):
    bag = drive()
    bag.imu(T0 + 305_000_000, gyro=(np.nan, 0.0, 0.0))
    recording, items = read(bag, tmp_path)
    assert len(stamps(items)) == 80
    assert codes(recording) == ["imu-bad"]


def test_empty_scans_are_kept_and_counted(tmp_path):
    bag = without(drive(20), "/points")
    for k in range(20):
        points = sweep(VELODYNE, 400, seed=k)
        points["time"] = np.linspace(0.0, 0.0998, 400)
        if k % 5 == 4:
            points["x"] = np.nan
        bag.cloud(points, T0 + k * PERIOD)
    recording, items = read(bag, tmp_path)
    assert [len(s) for s in scans(items)] == [0 if k % 5 == 4 else 400 for k in range(20)]
    assert all(s.end_ns >= s.stamp_ns for s in scans(items))
    assert codes(recording) == ["lidar-empty"]
    assert recording.tally.lidar.empty == 4


def test_reversed_stamps_are_refused(tmp_path):
    bag = without(drive(), "/points")
    for k in range(8):
        points = sweep(VELODYNE)
        points["time"] = np.linspace(0.0, 0.0998, 400)
        bag.cloud(points, T0 + (8 - k) * PERIOD, received_ns=T0 + k * PERIOD)
    with pytest.raises(DataError, match="run backwards"):
        read(bag, tmp_path)


def test_cloud_without_coordinates_is_refused(tmp_path):
    bag = without(drive(), "/points")
    bag.cloud(np.zeros(5, point_dtype([("range", "<f4", 0)], 4)), T0)
    with pytest.raises(DataError, match="without field 'x'"):
        read(bag, tmp_path)


def test_packets_of_an_unknown_maker_name_the_driver(tmp_path):
    from rosbags.typesys import get_types_from_msg
    from tests.bags import STORES

    kind = "pandar_msgs/msg/PandarScan"
    STORES[2].register(get_types_from_msg("std_msgs/Header header\n", kind))
    bag = without(drive(), "/points")
    from tests.bags import header

    bag.add("/pandar_packets", kind, T0 + 1, lambda store: store.types[kind](header=header(store, T0, "pandar")))
    with pytest.raises(DataError, match=r"packets, not points; replay it through .*nebula"):
        read(bag, tmp_path)


def test_samples_without_stamps_take_the_times_of_reception(tmp_path):
    bag = without(drive(), "/imu")
    for k in range(80):
        bag.imu(0, received_ns=T0 + k * 10_000_000)
    recording, items = read(bag, tmp_path)
    assert codes(recording) == ["no-stamps"]
    assert np.array_equal(stamps(items), T0 + np.arange(80) * 10_000_000)


def test_clocks_that_differ_are_reported(tmp_path):
    bag = without(drive(), "/imu")
    for k in range(80):
        bag.imu(T0 + k * 10_000_000 - 37_000_000_000, received_ns=T0 + k * 10_000_000)
    recording, _ = read(bag, tmp_path)
    assert codes(recording) == ["clock-mismatch"]
    assert "+37.000 s" in recording.events[0].message


def test_reversed_imu_stamps_are_refused(tmp_path):
    bag = without(drive(), "/imu")
    for k in range(80):
        bag.imu(T0 - k * 10_000_000, received_ns=T0 + k * 10_000_000)
    with pytest.raises(DataError, match="IMU stamps run backwards"):
        read(bag, tmp_path)


def test_transform_answers_for_every_frame(tmp_path):
    recording, _ = read(drive(), tmp_path)
    assert np.array_equal(recording.transform("imu"), np.eye(4))
    assert np.array_equal(recording.transform("lidar"), recording.rig.T_imu_lidar)
    assert np.allclose(recording.transform("base")[:3, 3], [-0.1, 0.0, -0.2])
    with pytest.raises(CalibrationError, match=r"'basis'.*did you mean 'base'"):
        recording.transform("basis")


def test_summary_is_plain_and_complete(tmp_path):
    import json

    recording, _ = read(drive(), tmp_path)
    summary = json.loads(json.dumps(recording.summary()))
    assert summary["streams"]["lidar"]["count"] == 8
    assert summary["streams"]["imu"]["rate_hz"] == pytest.approx(100.0)
    assert summary["topics"] == {"lidar": "/points", "imu": "/imu", "gnss": None}
    assert summary["scan_period_s"] == 0.1
    assert not summary["has_orientation"]


def test_report_gives_inferences_with_evidence_as_plain_values(tmp_path):
    import json

    path = drive().mcap(tmp_path / "a.mcap")
    with open_recording(path) as recording:
        report = inspect_recording(recording)
    content = json.loads(json.dumps(report.as_dict()))
    assert report.points_per_scan == 400
    assert {"point time field", "point time unit", "accelerometer unit", "T_imu_lidar"} <= {
        i["name"] for i in content["inferences"]
    }
    assert all(i["evidence"] for i in content["inferences"])
    assert report.frames == ("base", "imu", "lidar")


def test_cloud_without_a_coordinate_is_counted_as_unusable_by_both_ways_to_read(tmp_path):
    """Fields may change in mid-recording, behind what the first messages told."""
    renamed = {"names": ["c", *VELODYNE.names[1:]], "formats": [VELODYNE[k] for k in range(len(VELODYNE))]}
    offsets = [VELODYNE.fields[name][1] for name in VELODYNE.names]
    bag = drive(60)
    at = [k for k, message in enumerate(bag.messages) if message[0] == "/points"][50]
    points = sweep(VELODYNE).view(np.dtype({**renamed, "offsets": offsets, "itemsize": VELODYNE.itemsize}))
    (other,) = Bag().cloud(points, T0 + 50 * PERIOD).messages
    bag.messages[at] = other
    with open_recording(bag.mcap(tmp_path / "a.mcap")) as recording:
        report = inspect_recording(recording)
        assert (report.streams[0].count, report.streams[0].unusable) == (60, 1)
        assert report.points_per_scan == pytest.approx(59 * 400 / 60)
        assert len(scans(recording.stream())) == 59
        assert recording.tally.lidar.bad == 1


def test_prefetch_keeps_order_and_ends():
    assert list(prefetch(iter(range(50)), depth=3)) == list(range(50))


def test_prefetch_raises_where_the_iterator_did():
    def source():
        yield 1
        raise DataError("broken")

    items = prefetch(source())
    assert next(items) == 1
    with pytest.raises(DataError, match="broken"):
        next(items)


def test_prefetch_reads_ahead_only_so_far_and_stops_when_closed():
    taken = []

    def source():
        for k in range(10_000):
            taken.append(k)
            yield k

    items = prefetch(source(), depth=2)
    assert next(items) == 0
    time.sleep(0.2)
    assert len(taken) <= 5
    items.close()
    assert not any(thread.name == "heliograph-prefetch" for thread in threading.enumerate())
