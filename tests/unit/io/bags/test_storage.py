"""The lazy merge, and skipping to a time in every container."""

import pytest
from tests.bags import T0, drive

from heliograph.io.bags.rosbag import RosbagSource
from heliograph.io.bags.storage import merge_lazily, ros2_name
from heliograph.io.registry import open_raw_source


def opened(log, name, items):
    def factory():
        log.append(name)
        return iter(items)

    return factory


def test_merge_is_in_order_across_overlapping_streams():
    streams = [[5, 6, 7, 20], [1, 6, 8, 9], [2, 3], [], [15]]
    sources = [(stream[0] if stream else 4, opened([], "", stream)) for stream in streams]
    assert list(merge_lazily(sources, key=int)) == sorted(item for stream in streams for item in stream)


def test_merge_opens_a_stream_only_when_its_time_has_come():
    log = []
    sources = [
        (10, opened(log, "late", [10, 11])),
        (0, opened(log, "early", [0, 1, 9])),
        (30, opened(log, "last", [30])),
    ]
    merged = merge_lazily(sources, key=int)
    assert [next(merged) for _ in range(3)] == [0, 1, 9]
    assert log == ["early"]
    assert list(merged) == [10, 11, 30]
    assert log == ["early", "late", "last"]


def test_merge_accepts_a_start_that_is_only_a_lower_bound():
    sources = [(0, opened([], "", [8, 9])), (1, opened([], "", [1, 10])), (7, opened([], "", [7]))]
    assert list(merge_lazily(sources, key=int)) == [1, 7, 8, 9, 10]


def test_merge_keeps_the_order_of_equal_times():
    sources = [(0, opened([], "", [(1, "a"), (1, "b")])), (0, opened([], "", [(1, "c")]))]
    assert [name for _, name in merge_lazily(sources, key=lambda item: item[0])] == ["a", "b", "c"]


@pytest.mark.parametrize("kind", ["mcap", "sqlite", "ros 1", "ros 1 unindexed"])
def test_source_skips_to_a_time_of_reception(kind, tmp_path):
    bag = drive(20)
    if kind == "mcap":
        path = bag.mcap(tmp_path / "a.mcap")
    elif kind == "sqlite":
        path = bag.ros2(tmp_path / "a", storage="sqlite3")
    else:
        path = bag.ros1(tmp_path / "a.bag")
    if kind == "ros 1 unindexed":
        path.write_bytes(path.read_bytes()[:-300])
    source = open_raw_source([path])
    assert isinstance(source, RosbagSource)
    assert source.span_ns == (T0, T0 + 2_000_000_000)
    start = T0 + 1_230_000_000
    received = [m.received_ns for m in source.messages(frozenset({"/points", "/imu"}), start)]
    source.close()
    assert received[0] == start
    assert len(received) == 8 + 77  # clouds at 1.3 ... 2.0 s, samples at 1.23 ... 1.99 s


@pytest.mark.parametrize(
    ("name", "expected"),
    [("sensor_msgs/Imu", "sensor_msgs/msg/Imu"), ("sensor_msgs/msg/Imu", "sensor_msgs/msg/Imu"), ("Imu", "Imu")],
)
def test_message_types_are_named_as_in_ros2(name, expected):
    assert ros2_name(name) == expected
