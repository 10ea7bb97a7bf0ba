"""Files that promise more than they hold, unpack to more than memory, or are programs: one line, no memory."""

import bz2
import sqlite3
import struct
import tracemalloc
import zipfile
from contextlib import contextmanager
from importlib.util import find_spec

import lz4.frame
import numpy as np
import pytest
from tests.bags import CLOUD, T0, VELODYNE, Bag, drive, sweep

from heliograph.config import InputConfig
from heliograph.errors import ConfigError, DataError, FormatError
from heliograph.guard.boundary import outside
from heliograph.guard.limits import ReadLimits
from heliograph.guard.npz import read_npz
from heliograph.io import open_recording
from heliograph.io.bags.rosbag import open_rosbag
from heliograph.io.bags.unpack import UnpackTally, unpack, unpack_file, zstd
from heliograph.io.files.cloud_points import read_points
from heliograph.io.files.extrinsic import read_extrinsic
from heliograph.io.files.imu_tables import read_imu_table
from heliograph.io.files.stamps import parse_stamps
from heliograph.io.files.tum import read_tum
from heliograph.io.raw import RawCloud

SMALL = ReadLimits(chunk=1_000_000)
ZEROS = bytes(30_000_000)


@contextmanager
def at_most(megabytes):
    """Assert that the block's own memory stays below a bound."""
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < megabytes * 1e6, f"{peak / 1e6:.0f} MB"


PACKED = {"zstd": zstd.compress, "bz2": bz2.compress, "lz4": lz4.frame.compress}


@pytest.mark.parametrize("kind", PACKED)
def test_a_bomb_is_refused_before_it_goes_off(kind):
    bomb = PACKED[kind](ZEROS)
    with at_most(8.0):
        with pytest.raises(ValueError, match=r"input\.max_chunk allows 1 MB"):
            unpack(kind, bomb, SMALL)
        with pytest.raises(ValueError, match=r"30 MB or more, and input\.max_chunk"):
            unpack(kind, bomb, SMALL, size=len(ZEROS))
        with pytest.raises(ValueError, match="more than its 1000 bytes"):
            unpack(kind, bomb, SMALL, size=1000)
    assert bytes(unpack(kind, PACKED[kind](b"whole" * 99), SMALL, size=495)) == b"whole" * 99
    assert bytes(unpack(kind, PACKED[kind](b"a") + PACKED[kind](b"b"), SMALL)) == b"ab"
    with pytest.raises(ValueError):
        unpack(kind, PACKED[kind](b"whole" * 99)[:-8], SMALL)


@pytest.mark.parametrize("kind", PACKED)
@pytest.mark.parametrize("declared", [True, False])
def test_many_parts_that_are_allowed_each_are_too_much_together(kind, declared):
    part = PACKED[kind](bytes(900_000))
    limits = ReadLimits(chunk=1_000_000, ratio=10.0)
    tally, size = UnpackTally(limits), 900_000 if declared else None
    assert len(unpack(kind, part, limits, size=size, tally=tally)) == 900_000
    with at_most(3.0), pytest.raises(ValueError, match=r"more than 10 times their size.*input\.max_unpack_ratio"):
        unpack(kind, part, limits, size=size, tally=tally)
    incompressible = PACKED[kind](np.random.default_rng(1).bytes(500))
    for _ in range(3):  # what is no bomb is read all the same
        assert len(unpack(kind, incompressible, limits, size=500, tally=tally)) == 500


def test_a_file_that_unpacks_to_the_whole_disk_is_refused(tmp_path):
    packed = tmp_path / "drive.mcap.zstd"
    packed.write_bytes(zstd.compress(ZEROS))
    with pytest.raises(ValueError, match=r"more than 10 times its size.*input\.max_unpack_ratio"):
        unpack_file(packed, tmp_path / "out", ReadLimits(chunk=1000, ratio=10.0))
    with pytest.raises(ValueError, match=r"has room for 0 MB of its content.*TMPDIR"):
        unpack_file(packed, tmp_path / "out", ReadLimits(ratio=1e9, reserve=1 << 60))
    with pytest.raises(FormatError, match=rf"{packed.name}.*max_unpack_ratio"):
        open_recording(packed, InputConfig(max_chunk=1.0, max_unpack_ratio=10.0))


def test_errors_of_a_packed_file_name_the_file_itself(tmp_path):
    packed = tmp_path / "drive.mcap.zstd"
    packed.write_bytes(zstd.compress(b"\x89MCAP0\r\n" + bytes(100)))
    with pytest.raises(FormatError, match=r"drive\.mcap\.zstd: no readable message") as caught:
        open_recording(packed)
    assert "heliograph-" not in str(caught.value)
    whole = drive(5).mcap(tmp_path / "whole.mcap").read_bytes()
    packed.write_bytes(zstd.compress(whole[: len(whole) // 2]))
    with open_recording(packed) as recording:
        assert any(packed.name in event.message for event in recording.events if event.code == "truncated")
        assert not any("0-drive" in event.message for event in recording.events)


def test_chunks_beyond_the_limit_are_left_out_and_told(tmp_path):
    bag = drive(6).ros1(tmp_path / "drive.bag", "bz2")
    mcap = next(drive(6).ros2(tmp_path / "packed", compression="storage").glob("*.mcap"))
    single = next(drive(6).ros2(tmp_path / "single", storage="sqlite3", compression="message").glob("*.db3"))
    for path in (bag, mcap, single.parent):
        source = open_rosbag([path], ReadLimits(chunk=300))
        assert not any(isinstance(m, RawCloud) for m in source.messages(frozenset({"/points", "/imu"})))
        assert any("input.max_chunk allows" in event.message for event in source.events), path
        source.close()


def endless(path):
    db = sqlite3.connect(path)
    db.execute("ALTER TABLE messages RENAME TO others")
    numbers = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
    db.execute(f"CREATE VIEW messages AS {numbers} SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n")
    db.commit()
    db.close()


def crowded(path):
    db = sqlite3.connect(path)
    rows = (("sensor_msgs/msg/Imu", f"/t{k}") for k in range(10_050))
    db.executemany("INSERT INTO topics(name, type, serialization_format, offered_qos_profiles, type_description_hash) "
                   "SELECT ?2, ?1, 'cdr', '', ''", rows)  # fmt: skip
    db.commit()
    db.close()


@pytest.mark.parametrize(
    ("spoil", "words"), [(endless, "no plain table but computed"), (crowded, "more than 10000 topics")]
)
def test_a_database_that_never_ends_is_refused(spoil, words, tmp_path):
    path = next(drive(4).ros2(tmp_path / "s", storage="sqlite3").glob("*.db3"))
    spoil(path)
    with at_most(40.0), pytest.raises(FormatError, match=words):
        open_recording(path)


def test_cells_of_a_wrong_kind_cost_their_rows(tmp_path):
    path = next(drive(5).ros2(tmp_path / "s", storage="sqlite3").glob("*.db3"))
    db = sqlite3.connect(path)
    db.execute("UPDATE messages SET timestamp = 'late' WHERE rowid = 3")
    db.execute("UPDATE messages SET data = 7 WHERE rowid = 4")
    db.execute("UPDATE topics SET name = CAST(x'2FFFFE' AS TEXT) WHERE name = '/tf_static'")
    db.commit()
    db.close()
    with open_recording(path) as recording:
        assert sum(1 for _ in recording.stream()) > 3
        assert any("rows have no stamp" in event.message for event in recording.events)


@pytest.mark.parametrize("count", [10**9, 10**30])
def test_clouds_that_promise_too_many_points_take_no_memory(count, tmp_path):
    ply, pcd = tmp_path / "a.ply", tmp_path / "a.pcd"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    ply.write_bytes(
        f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{axes}end_header\n".encode() + bytes(99)
    )
    fields = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS {count}\nDATA binary\n"
    pcd.write_bytes(fields.encode() + bytes(99))
    wide = tmp_path / "wide.pcd"
    wide.write_bytes(fields.replace("COUNT 1", "COUNT 2147483647").replace(str(count), "9").encode() + bytes(99))
    with at_most(1.0):
        for path in (ply, pcd, wide):
            with pytest.raises(FormatError, match=r"a\.ply|a\.pcd|wide\.pcd"):
                read_points(path)


def test_lzf_that_cannot_be_is_refused(tmp_path):
    path = tmp_path / "a.pcd"
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 5\nDATA binary_compressed\n"
    for packed, unpacked, data in ((8, 2**32 - 1, bytes(8)), (8, 60, b"\xff" * 8), (8, 60, bytes(8))):
        path.write_bytes(head.encode() + struct.pack("<II", packed, unpacked) + data)
        with at_most(1.0), pytest.raises(FormatError, match=r"a\.pcd"):
            read_points(path)


def test_lzf_of_zeros_takes_no_more_than_it_may(tmp_path):
    """Each three bytes of back reference stand for 264: 21 MB of them for 1.8 GB."""
    path, body = tmp_path / "a.pcd", b"\x00\x00" + b"\xe0\xff\x00" * 1_200_000
    points = (1 + 264 * 1_200_000) // 12
    head = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS {points}\nDATA binary_compressed\n"
    path.write_bytes(head.encode() + struct.pack("<II", len(body), 1 + 264 * 1_200_000) + body)
    with at_most(8.0), pytest.raises(FormatError, match=r"317 MB, more than 20 times its weight"):
        read_points(path)


def test_an_archive_takes_what_it_weighs(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, numbers=np.arange(6.0).reshape(2, 3), name="imu", columns=np.asfortranarray(np.eye(3)))
    whole = read_npz(path)
    assert whole["numbers"].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    assert str(whole["name"]) == "imu" and whole["columns"].tolist() == np.eye(3).tolist()
    np.savez_compressed(path, zeros=np.zeros(3_000_000))
    with at_most(1.0), pytest.raises(ValueError, match=r"promises more than the file holds|compressed"):
        read_npz(path)
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117) + "\n"
    for text in (
        header,
        "(" * 5000,
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n",
        "{'descr': 3}\n",
        "'''",
    ):
        with zipfile.ZipFile(path, "w") as archive:
            content = text.encode()
            archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(content)) + content + bytes(8))
        with at_most(2.0), pytest.raises(ValueError):
            read_npz(path)


@pytest.mark.parametrize("word", ["9" * 25, "9" * 400, "1e999999999", "-1e300", "nan", "inf", "1e30"])
def test_a_stamp_that_is_no_time_is_told(word, tmp_path):
    for unit in (None, "s", "ns"):
        with pytest.raises(ValueError):
            parse_stamps(["1", word], unit)
    table = tmp_path / "imu.csv"
    table.write_text(f"time,gx,gy,gz,ax,ay,az\n1,0,0,0,0,0,9.8\n{word},0,0,0,0,0,9.8\n")
    poses = tmp_path / "poses.tum"
    poses.write_text(f"{word} 0 0 0 0 0 0 1\n")
    with pytest.raises(FormatError):
        read_tum(poses)
    if np.isfinite(float(word)):  # the others are rows that hold no numbers
        with pytest.raises(FormatError, match=r"imu\.csv"):
            read_imu_table(table)


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 20_000, "reference_ns = " + "9" * 5000, "matrix = [" + "9" * 400 + "]", "\x00"]
)
def test_toml_that_no_parser_bears_is_told(text, tmp_path):
    path = tmp_path / "extrinsic.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"extrinsic\.toml") as caught:
        read_extrinsic(path)
    assert len(str(caught.value)) < 2000


@pytest.mark.parametrize("text", ["a: " + "[" * 5000, "a: &x [1]\nb: [*x, *x]", "- " * 3000, "\x00", "a"])
def test_metadata_that_no_parser_bears_is_left_aside(text, tmp_path):
    folder = drive(5).ros2(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(text)
    with open_recording(folder) as recording:
        assert sum(1 for _ in recording.stream()) > 3
        assert "bad-metadata" in {event.code for event in recording.events}


def test_the_boundary_tells_a_library_from_ourselves(tmp_path):
    with pytest.raises(FormatError, match=r"drive\.bag: is damaged \(unbalanced"), outside("drive.bag"):
        _library("unbalanced")

    def own():
        scope = {"__name__": "heliograph.somewhere"}
        exec("def fail():\n    raise KeyError('ours')", scope)
        scope["fail"]()

    with pytest.raises(KeyError, match="ours"), outside("drive.bag"):
        own()


def _library(word):
    raise RuntimeError(word)


@pytest.mark.parametrize("big", [False, True])
def test_a_byte_order_that_lies_is_noticed(big, tmp_path):
    def lying(store, points, stamp_ns):
        from tests.bags import cloud_message

        message = cloud_message(store, points, stamp_ns)
        message.is_bigendian = not message.is_bigendian
        return message

    bag = Bag()
    for k in range(6):
        points = sweep(VELODYNE, seed=k)
        points["time"] = np.linspace(0.0, 0.0998, len(points))
        stored = points.astype(VELODYNE.newbyteorder(">")) if big else points
        stamp = T0 + 100_000_000 * k
        bag.add("/points", CLOUD, stamp + 100_000_000, lambda store, p=stored, t=stamp: lying(store, p, t))
        for j in range(20):
            bag.imu(stamp + j * 5_000_000)
    with open_recording(bag.mcap(tmp_path / "a.mcap")) as recording:
        scans = [message for message in recording.stream() if hasattr(message, "points")]
        assert [event.code for event in recording.events].count("byte-order") == 1
    np.testing.assert_array_equal(scans[0].points, np.stack([sweep(VELODYNE, seed=0)[a] for a in "xyz"], axis=1))


def test_a_point_time_that_is_none_costs_its_scan(tmp_path):
    bag = drive(8)
    points = sweep(VELODYNE, seed=3)
    points["time"] = np.float32(3e38)
    bag.cloud(points, T0 + 850_000_000)
    with open_recording(bag.mcap(tmp_path / "a.mcap")) as recording:
        assert sum(hasattr(message, "points") for message in recording.stream()) == 8
        assert recording.tally.lidar.bad == 1


@pytest.mark.skipif(find_spec("velodyne_decoder") is None, reason="needs velodyne-decoder")
def test_a_velodyne_packet_of_an_unknown_model_costs_itself():
    from heliograph.io.packets.velodyne import PACKET_SIZE, VelodyneDecoder

    decoder = VelodyneDecoder("/points")
    good = bytearray(PACKET_SIZE)
    for block in range(12):
        good[100 * block : 100 * block + 2] = b"\xff\xee"
        good[100 * block + 5 : 100 * block + 100 : 3] = bytes([9]) * 32
    good[-2:] = b"\x37\x22"
    bad = bytes(good[:-1]) + b"\xa3"
    found = [cloud for data in (bad, good, good, bad, good) for cloud in decoder.feed(bytes(data), T0)]
    found += decoder.finish()
    assert decoder.bad_packets == 2
    assert sum(len(cloud.columns["x"]) for cloud in found) > 0


def test_more_topics_than_any_recording_has_are_refused(tmp_path):
    path = drive(4).mcap(tmp_path / "a.mcap")
    with pytest.raises(FormatError, match="holds 3 topics"):
        open_rosbag([path], ReadLimits(topics=2))
    with pytest.raises(DataError):
        open_recording(path, InputConfig(lidar_topic="/nowhere"))
