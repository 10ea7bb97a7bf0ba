"""Every container gives the same messages; a damaged one gives its readable part and a warning."""

import shutil

import numpy as np
import pytest
from rosbags.rosbag1 import Reader
from tests.bags import T0, Bag, drive

from heliograph.data import GnssFix, ImuBatch, Scan
from heliograph.errors import FormatError
from heliograph.io import open_recording, prefetch
from heliograph.io.bags.bag1 import Bag1Storage


def read(paths, **kw):
    with open_recording(paths, **kw) as recording:
        items = list(recording.stream())
        return recording, items


def scans_of(items):
    return [item for item in items if isinstance(item, Scan)]


def imu_stamps(items):
    return np.concatenate([item.stamps_ns for item in items if isinstance(item, ImuBatch)] or [np.empty(0, np.int64)])


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return read(drive().mcap(tmp_path_factory.mktemp("reference") / "drive.mcap"))


WRITERS = {
    "mcap folder": lambda bag, p: bag.ros2(p / "bag"),
    "mcap message zstd": lambda bag, p: bag.ros2(p / "bag", compression="message"),
    "mcap file zstd": lambda bag, p: bag.ros2(p / "bag", compression="file"),
    "mcap chunk zstd": lambda bag, p: bag.ros2(p / "bag", compression="storage"),
    "sqlite folder": lambda bag, p: bag.ros2(p / "bag", storage="sqlite3"),
    "sqlite message zstd": lambda bag, p: bag.ros2(p / "bag", storage="sqlite3", compression="message"),
    "sqlite file zstd": lambda bag, p: bag.ros2(p / "bag", storage="sqlite3", compression="file"),
    "ros 1 bag": lambda bag, p: bag.ros1(p / "a.bag"),
    "ros 1 bag bz2": lambda bag, p: bag.ros1(p / "a.bag", "bz2"),
    "ros 1 bag lz4": lambda bag, p: bag.ros1(p / "a.bag", "lz4"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_container_gives_the_same_stream(name, tmp_path, reference):
    recording, items = read(WRITERS[name](drive(), tmp_path))
    first, expected = reference
    assert [type(item) for item in items] == [type(item) for item in expected]
    for scan, wanted in zip(scans_of(items), scans_of(expected), strict=True):
        assert scan.stamp_ns == wanted.stamp_ns
        assert np.array_equal(scan.points, wanted.points)
        assert np.array_equal(scan.offsets_ns, wanted.offsets_ns)
        assert np.array_equal(scan.ring, wanted.ring)
    assert np.array_equal(imu_stamps(items), imu_stamps(expected))
    assert np.array_equal(recording.rig.T_imu_lidar, first.rig.T_imu_lidar)
    assert recording.events == first.events == []


def test_file_inside_a_bag_opens_without_its_metadata(tmp_path, reference):
    folder = drive().ros2(tmp_path / "bag", storage="sqlite3")
    _, items = read(next(folder.glob("*.db3")))
    assert len(scans_of(items)) == len(scans_of(reference[1]))


def split(parts: int) -> list[Bag]:
    whole = sorted(drive().messages, key=lambda m: m[2])
    size = -(-len(whole) // parts)
    return [Bag(whole[i : i + size]) for i in range(0, len(whole), size)]


@pytest.mark.parametrize("kind", ["paths", "folder of bags", "folder of files", "ros 1 paths"])
def test_split_recording_reads_as_one(kind, tmp_path, reference):
    bags = split(3)
    if kind == "ros 1 paths":
        paths = [bag.ros1(tmp_path / f"{i}.bag") for i, bag in enumerate(bags)]
    elif kind == "folder of files":
        paths = [tmp_path / "all"]
        paths[0].mkdir()
        for i, bag in enumerate(bags):
            bag.mcap(paths[0] / f"{i}.mcap")
    else:
        paths = [
            bag.ros2(tmp_path / "all" / f"{i}") if (tmp_path / "all").mkdir(exist_ok=True) is None else None
            for i, bag in enumerate(bags)
        ]
    if kind == "paths":
        paths = paths[::-1]  # their order on the command line must not matter
    elif kind == "folder of bags":
        paths = [tmp_path / "all"]
    _, items = read(paths)
    expected = reference[1]
    assert [s.stamp_ns for s in scans_of(items)] == [s.stamp_ns for s in scans_of(expected)]
    assert np.array_equal(imu_stamps(items), imu_stamps(expected))


def test_bag_with_two_files_in_its_metadata_reads_both(tmp_path, reference):
    one, two = split(2)
    folder = one.ros2(tmp_path / "bag")
    second = two.mcap(tmp_path / "bag_1.mcap")
    shutil.move(second, folder / "bag_1.mcap")
    metadata = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(metadata.replace("  - bag.mcap\n", "  - bag.mcap\n  - bag_1.mcap\n"))
    _, items = read(folder)
    assert len(scans_of(items)) == len(scans_of(reference[1]))


def test_bag_with_a_missing_file_uses_the_others_and_warns(tmp_path):
    folder = drive().ros2(tmp_path / "bag")
    metadata = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(metadata.replace("  - bag.mcap\n", "  - bag.mcap\n  - bag_1.mcap\n"))
    recording, items = read(folder)
    assert len(scans_of(items)) == 8
    assert [e.code for e in recording.events] == ["missing-file"]
    assert "bag_1.mcap" in recording.events[0].message


def cut(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


@pytest.mark.parametrize("share", [0.4, 0.7, 0.95])
def test_cut_off_mcap_gives_its_readable_part(share, tmp_path):
    path = drive(40).mcap(tmp_path / "a.mcap")
    # rosbags writes chunks of 1 MiB; small ones make a prefix readable
    recording, items = read(cut(rechunked(path, tmp_path / "b.mcap"), share))
    assert [e.code for e in recording.events if e.code == "truncated"] == ["truncated"]
    assert 0.6 * share * 40 <= len(scans_of(items)) <= 40
    assert all(len(s) == 400 for s in scans_of(items))


def test_mcap_without_summary_gives_everything(tmp_path):
    path = rechunked(drive().mcap(tmp_path / "a.mcap"), tmp_path / "b.mcap")
    data = path.read_bytes()
    path.write_bytes(data[: data.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")])  # from the data-end record on
    recording, items = read(path)
    assert len(scans_of(items)) == 8
    assert "no end record" in recording.events[0].message


def rechunked(path, target):
    """Write the same messages again, one message a chunk, so that a cut leaves whole chunks."""
    import struct

    from heliograph.io.bags.mcap import CHANNEL, CHUNK, MAGIC, MESSAGE, SCHEMA, McapStorage, _decompress, _records

    def record(opcode, body):
        return struct.pack("<BQ", opcode, len(body)) + body

    storage = McapStorage(path, [])
    out = MAGIC + record(0x01, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0))
    for opcode, body, _ in storage._top_level():
        if opcode != CHUNK:
            continue
        for inner, data in _records(_decompress(body)):
            if inner in (SCHEMA, CHANNEL):
                out += record(inner, bytes(data))
            elif inner == MESSAGE:
                time = struct.unpack_from("<HIQQ", data)[2]
                content = record(MESSAGE, bytes(data))
                head = struct.pack("<QQQIIQ", time, time, len(content), 0, 0, len(content))
                out += record(CHUNK, head + content)
    storage.close()
    out += record(0x0F, struct.pack("<I", 0)) + record(0x02, struct.pack("<QQI", 0, 0, 0)) + MAGIC
    target.write_bytes(out)
    return target


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_cut_off_mcap_chunk_gives_its_readable_part_with_one_warning(share, tmp_path):
    path = cut(drive(60).mcap(tmp_path / "a.mcap"), share)  # all messages are in one chunk
    recording, items = read(path)
    assert [e.code for e in recording.events] == ["truncated"]
    assert 0.8 * share * 60 <= len(scans_of(items)) < 60


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_cut_off_sqlite_file_gives_its_readable_part(share, tmp_path):
    folder = drive(60).ros2(tmp_path / "bag", storage="sqlite3")
    cut(next(folder.glob("*.db3")), share)
    with open_recording(folder) as recording:
        items = list(prefetch(recording.stream()))
        assert [e.code for e in recording.events] == ["truncated"]
    stamps = [s.stamp_ns for s in scans_of(items)]
    assert 0.8 * share * 60 <= len(stamps) < 60
    assert stamps == [T0 + k * 100_000_000 for k in range(len(stamps))]


def test_sqlite_bag_is_read_in_another_thread(tmp_path, reference):
    with open_recording(drive().ros2(tmp_path / "bag", storage="sqlite3")) as recording:
        assert len(scans_of(list(prefetch(recording.stream())))) == len(scans_of(reference[1]))


@pytest.mark.parametrize("compression", ["", "lz4"])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_cut_off_ros1_bag_gives_its_readable_part(share, compression, tmp_path):
    bag = drive(120)
    path = cut(bag.ros1(tmp_path / "a.bag", compression), share)
    recording, items = read(path)
    assert "truncated" in [e.code for e in recording.events]
    found = [s.stamp_ns for s in scans_of(items)]
    assert found == [T0 + k * 100_000_000 for k in range(len(found))]
    assert 20 <= len(found) < 120


def test_index_that_leads_to_messages_of_another_topic_gives_none_of_them(tmp_path, monkeypatch):
    """A damaged index of a ROS 1 bag: the library hands on whatever message it points at."""
    every = Reader.messages
    monkeypatch.setattr(Reader, "messages", lambda self, *_, start: every(self, start=start))
    storage = Bag1Storage(drive().ros1(tmp_path / "a.bag"), [])
    assert {channel.topic for channel, *_ in storage.messages(frozenset({"/imu"}), 0)} == {"/imu"}
    storage.close()


def test_unindexed_ros1_bag_is_used_with_a_warning(tmp_path):
    path = drive().ros1(tmp_path / "a.bag")
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)  # what a recorder writes first and replaces at the end
    path.write_bytes(data)
    recording, items = read(path)
    assert len(scans_of(items)) == 8
    assert [e.code for e in recording.events] == ["truncated"]


@pytest.mark.parametrize("summary", [True, False])
def test_mcap_with_a_damaged_chunk_loses_only_that_chunk(summary, tmp_path):
    folder = drive(300).ros2(tmp_path / "bag", compression="storage")
    file = next(folder.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    second = data.index(b"\x04\x00\x00\x00zstd", data.index(b"\x04\x00\x00\x00zstd") + 10)
    data[second + 60 : second + 100] = bytes(40)
    file.write_bytes(data if summary else data[: data.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")])
    recording, items = read(folder)
    assert "damaged-chunk" in [e.code for e in recording.events]
    stamps = [s.stamp_ns for s in scans_of(items)]
    assert 100 < len(stamps) < 300
    assert stamps[0] == T0
    assert stamps[-1] == T0 + 299 * 100_000_000


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.mcap", b"hello world, not a recording"), ("a.bag", b"\0" * 100), ("a.db3", b"text"), ("a.xyz", b"1 2 3")],
)
def test_file_that_is_no_recording_is_refused_in_one_line(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FormatError) as caught:
        open_recording(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_empty_and_blank_inputs_are_refused(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "blank.mcap").touch()
    for path, word in (
        (tmp_path / "nowhere.bag", "no such"),
        (tmp_path / "folder", "empty"),
        (tmp_path / "blank.mcap", "empty"),
    ):
        with pytest.raises(FormatError, match=word):
            open_recording(path)


def test_mcap_cut_before_its_first_message_is_refused(tmp_path):
    path = drive().mcap(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(FormatError, match="no readable message"):
        open_recording(path)


def test_start_and_duration_select_by_time_of_reception(tmp_path):
    from heliograph.config import InputConfig

    path = drive(20).mcap(tmp_path / "a.mcap")
    with open_recording(path, InputConfig(start=0.55, duration=0.5)) as recording:
        items = list(recording.stream())
        expected = recording.total_scans
    times = [item.received_ns for item in items]
    assert min(times) >= T0 + 550_000_000
    assert max(times) <= T0 + 1_050_000_000
    assert len(scans_of(items)) == expected == 5


def test_fixes_are_streamed_with_their_covariance(tmp_path):
    from tests.bags import FIX, fix_message

    bag = drive()
    bag.add("/fix", FIX, T0 + 5, lambda store: fix_message(store, T0))
    bag.add("/fix", FIX, T0 + 10**8, lambda store: fix_message(store, T0 + 10**8, status=-1))
    _, items = read(bag.mcap(tmp_path / "a.mcap"))
    fixes = [item for item in items if isinstance(item, GnssFix)]
    assert [fix.valid for fix in fixes] == [True, False]
    assert fixes[0].latitude_deg == 48.1
    assert np.array_equal(np.diag(fixes[0].covariance_enu), [1.0, 2.0, 3.0])
