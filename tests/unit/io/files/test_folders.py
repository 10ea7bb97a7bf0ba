"""Folders of clouds: stamps from lists, names or an assumption; IMU tables and mountings beside them."""

import numpy as np
import pytest

from heliograph.errors import FormatError
from heliograph.io.files.clouds import write_cloud
from heliograph.io.files.folders import open_cloud_folder
from heliograph.io.raw import RawCloud, RawImu
from heliograph.io.recording import open_recording

START = 1_700_000_000_000_000_000
PERIOD = 100_000_000


def make_folder(folder, rng, names, suffix=".pcd", **columns):
    folder.mkdir(parents=True, exist_ok=True)
    for index, name in enumerate(names):
        points = rng.normal(size=(200, 3)).astype(np.float32)
        points[:, 0] += index
        write_cloud(folder / f"{name}{suffix}", points, columns=columns or None)
    return folder


def clouds_of(path):
    source = open_cloud_folder([path])
    return source, list(source.messages(frozenset(topic.name for topic in source.topics)))


@pytest.mark.parametrize(
    "names",
    [
        [str(START + i * PERIOD) for i in range(3)],
        [f"1700000000.{i}" for i in range(3)],
        [f"1700000000_{i * PERIOD:09d}" for i in range(3)],
        [str((START + i * PERIOD) // 1000) for i in range(3)],
    ],
    ids=["nanoseconds", "seconds", "sec_nsec", "microseconds"],
)
@pytest.mark.parametrize("suffix", [".pcd", ".ply"])
def test_cloud_names_are_stamps(tmp_path, rng, names, suffix):
    _, messages = clouds_of(make_folder(tmp_path / "run", rng, names, suffix))
    assert [message.stamp_ns for message in messages] == [START + i * PERIOD for i in range(3)]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("times.txt", "1700000000.0\n1700000000.1\n1700000000.2\n"),
        ("timestamps.csv", f"index,stamp\n0,{START}\n1,{START + PERIOD}\n2,{START + 2 * PERIOD}\n"),
        ("timestamps.csv", f"file,stamp\na.pcd,{START}\nb.pcd,{START + PERIOD}\nc.pcd,{START + 2 * PERIOD}\n"),
        ("../times.txt", f"# ns\n{START}\n{START + PERIOD}\n{START + 2 * PERIOD}\n"),
    ],
)
def test_cloud_stamps_are_read_from_a_list(tmp_path, rng, name, text):
    folder = make_folder(tmp_path / "run" / "scans", rng, ["8", "9", "10"])
    (folder / name).write_text(text)
    _, messages = clouds_of(tmp_path / "run")
    assert [message.stamp_ns for message in messages] == [START + i * PERIOD for i in range(3)]
    assert [round(float(np.median(message.columns["x"]))) for message in messages] == [0, 1, 2]


def test_clouds_come_in_the_order_of_their_stamps(tmp_path, rng):
    folder = make_folder(tmp_path / "run", rng, ["a", "b", "c"])
    (folder / "times.txt").write_text("0.3\n0.1\n0.2\n")
    _, messages = clouds_of(folder)
    assert [message.stamp_ns for message in messages] == [100_000_000, 200_000_000, 300_000_000]
    assert [round(float(np.median(message.columns["x"]))) for message in messages] == [1, 2, 0]


def test_cloud_stamps_that_do_not_fit_are_refused(tmp_path, rng):
    folder = make_folder(tmp_path / "run", rng, ["0", "1", "2"])
    (folder / "times.txt").write_text("0.0\n0.1\n")
    with pytest.raises(FormatError, match="has 2 stamps for 3 clouds"):
        open_cloud_folder([folder])


def test_clouds_without_stamps_are_taken_at_ten_hertz_with_a_warning(tmp_path, rng):
    source, messages = clouds_of(make_folder(tmp_path / "run", rng, ["a", "b"]))
    assert [message.stamp_ns for message in messages] == [0, PERIOD]
    assert [event.code for event in source.events] == ["assumed-stamps"]


def test_clouds_without_stamps_beside_an_imu_are_refused(tmp_path, rng):
    folder = make_folder(tmp_path / "run", rng, ["000000", "000001"])
    (folder / "imu.csv").write_text("t,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n")
    with pytest.raises(FormatError, match=r"add times\.txt"):
        open_cloud_folder([folder])


def test_cloud_folder_merges_imu_and_keeps_columns(tmp_path, rng):
    offsets = np.arange(200, dtype=np.uint32) * 400_000
    folder = make_folder(tmp_path / "run", rng, [str(START), str(START + PERIOD)], t=offsets)
    stamps = START + np.arange(40) * 5_000_000
    rows = [f"{stamp},0,0,0.1,0,0,9.8" for stamp in stamps]
    (folder / "imu.csv").write_text("\n".join(["timestamp,gx,gy,gz,ax,ay,az", *rows]))
    (folder / "extrinsic.toml").write_text("[T_imu_lidar]\nrotation = [0, 0, 0, 1]\ntranslation = [0.1, 0, 0]\n")
    source, messages = clouds_of(folder)
    received = [message.received_ns for message in messages]
    assert received == sorted(received)
    clouds = [message for message in messages if isinstance(message, RawCloud)]
    samples = [message for message in messages if isinstance(message, RawImu)]
    assert (len(clouds), len(samples)) == (2, 40)
    np.testing.assert_array_equal(clouds[0].columns["t"], offsets)
    assert samples[3].accel == (0.0, 0.0, 9.8)
    assert source.factory_T_imu_lidar()[0][0, 3] == pytest.approx(0.1)
    with open_recording(folder) as recording:
        assert recording.sensors == {"lidar", "imu"}
        scans = [m for m in recording.stream() if hasattr(m, "offsets_ns")]
        assert [scan.end_ns - scan.stamp_ns for scan in scans] == [199 * 400_000] * 2
        assert recording.rig.T_imu_lidar[0, 3] == pytest.approx(0.1)


def test_damaged_clouds_are_left_out_with_one_event(tmp_path, rng):
    folder = make_folder(tmp_path / "run", rng, [str(START), str(START + PERIOD)])
    first = folder / f"{START}.pcd"
    first.write_bytes(first.read_bytes()[:-100])
    source, messages = clouds_of(folder)
    list(source.messages(frozenset(["/points"])))
    assert [message.stamp_ns for message in messages] == [START + PERIOD]
    assert [event.code for event in source.events] == ["damaged-scan"]


def test_other_folders_are_not_taken(tmp_path):
    (tmp_path / "notes.txt").touch()
    assert open_cloud_folder([tmp_path]) is None
    assert open_cloud_folder([tmp_path / "notes.txt"]) is None


def test_public_keyframes_open(shared_data):
    source = open_cloud_folder([shared_data / "keyframes" / "hku_1"])
    messages = list(source.messages(frozenset(["/points"])))
    assert len(messages) == 314
    assert messages[0].stamp_ns == 1_577_836_980_099_104_600
    assert (messages[-1].stamp_ns - messages[0].stamp_ns) * 1e-9 == pytest.approx(124, abs=10)
