"""KITTI folders, made small here."""

import numpy as np
import pytest

from heliograph.errors import FormatError
from heliograph.io.files.kitti import open_kitti
from heliograph.io.raw import RawCloud, RawFix, RawImu
from heliograph.io.recording import open_recording

START = int(np.datetime64("2011-09-26T13:02:25.900000000", "ns").astype(np.int64))
TURN = 103_000_000
R = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


def dates(stamps):
    return "".join(str(np.datetime64(int(stamp), "ns")).replace("T", " ") + "\n" for stamp in stamps)


def ring(azimuths):
    points = np.zeros((len(azimuths), 4), dtype=np.float32)
    points[:, 0], points[:, 1] = 10 * np.cos(azimuths), 10 * np.sin(azimuths)
    return points


def make_drive(folder, numbers=(0, 1, 3), text=False):
    drive = folder / "2011_09_26_drive_0001_sync"
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    (drive / "oxts" / "data").mkdir(parents=True)
    starts = START + np.arange(4) * TURN
    for name, shift in (("timestamps_start", 0), ("timestamps", TURN // 2), ("timestamps_end", TURN)):
        (drive / "velodyne_points" / f"{name}.txt").write_text(dates(starts + shift))
    (drive / "oxts" / "timestamps.txt").write_text(dates(starts + TURN // 2))
    # Behind on the left, left, front, right, behind on the right: the order of a clockwise turn.
    points = ring(np.deg2rad([179.9, 90.0, 0.0, -90.0, -179.9]))
    for number in numbers:
        path = drive / "velodyne_points" / "data" / f"{number:010d}.bin"
        points.tofile(path) if not text else np.savetxt(path.with_suffix(".txt"), points)
    values = np.arange(30.0)
    for number in range(4):
        (drive / "oxts" / "data" / f"{number:010d}.txt").write_text(" ".join(map(str, values)))
    rotation = " ".join(str(value) for row in R for value in row)
    (folder / "calib_imu_to_velo.txt").write_text(f"calib_time: 25-May\nR: {rotation}\nT: 1.0 2.0 3.0\n")
    return drive


def all_messages(source):
    return list(source.messages(frozenset(topic.name for topic in source.topics)))


@pytest.mark.parametrize("text", [False, True])
def test_raw_drive_times_points_by_a_clockwise_turn_from_behind(tmp_path, text):
    source = open_kitti([make_drive(tmp_path, text=text)])
    clouds = [message for message in all_messages(source) if isinstance(message, RawCloud)]
    assert [cloud.stamp_ns for cloud in clouds] == [START + n * TURN + TURN // 2 for n in (0, 1, 3)]
    expected = np.array([-0.5, -0.25, 0.0, 0.25, 0.5]) * TURN * 1e-9
    np.testing.assert_allclose(clouds[0].columns["time"], expected, rtol=0, atol=5e-5)


def test_raw_drive_orders_its_streams_and_names_its_columns(tmp_path):
    source = open_kitti([make_drive(tmp_path)])
    messages = all_messages(source)
    received = [message.received_ns for message in messages]
    assert received == sorted(received)
    sample = next(message for message in messages if isinstance(message, RawImu))
    assert sample.accel == (11.0, 12.0, 13.0)
    assert sample.gyro == (17.0, 18.0, 19.0)
    fix = next(message for message in messages if isinstance(message, RawFix))
    assert (fix.latitude_deg, fix.longitude_deg, fix.altitude) == (0.0, 1.0, 2.0)
    assert {topic.kind: topic.count for topic in source.topics} == {"lidar": 3, "imu": 4, "gnss": 4}


def test_raw_drive_calibration_is_inverted(tmp_path):
    T_imu_lidar, name = open_kitti([make_drive(tmp_path)]).factory_T_imu_lidar()
    p_imu = np.array([0.3, -0.7, 2.0, 1.0])
    p_velo = np.append(np.array(R) @ p_imu[:3] + [1.0, 2.0, 3.0], 1.0)
    np.testing.assert_allclose(T_imu_lidar @ p_velo, p_imu, rtol=0, atol=1e-12)
    assert "calib_imu_to_velo.txt" in name


def test_raw_drive_survives_damage_and_says_so(tmp_path):
    drive = make_drive(tmp_path)
    scan = drive / "velodyne_points" / "data" / "0000000001.bin"
    scan.write_bytes(scan.read_bytes()[:-3])
    (drive / "oxts" / "data" / "0000000002.txt").write_text("1 2 3")
    source = open_kitti([drive])
    kinds = [type(message) for message in all_messages(source)]
    all_messages(source)
    assert (kinds.count(RawCloud), kinds.count(RawImu)) == (2, 3)
    assert sorted(event.code for event in source.events) == ["damaged-sample", "damaged-scan"]


def test_raw_drive_without_stamps_or_scans_is_refused(tmp_path):
    drive = make_drive(tmp_path)
    stamps = drive / "velodyne_points" / "timestamps_end.txt"
    stamps.write_text("yesterday\n")
    with pytest.raises(FormatError, match="line 1 is no date and time"):
        open_kitti([drive])
    stamps.write_text(dates([START]))
    with pytest.raises(FormatError, match="has 1 stamps, but a file of number 3"):
        open_kitti([drive])
    stamps.unlink()
    with pytest.raises(FormatError, match="cannot be used without its stamps"):
        open_kitti([drive])
    for path in (drive / "velodyne_points" / "data").iterdir():
        path.unlink()
    with pytest.raises(FormatError, match="holds no scans"):
        open_kitti([drive])


def test_raw_drive_opens_as_a_recording(tmp_path):
    with open_recording(make_drive(tmp_path)) as recording:
        assert recording.sensors >= {"lidar", "imu"}
        scans = [m for m in recording.stream() if hasattr(m, "offsets_ns")]
    assert scans[0].stamp_ns == pytest.approx(START, abs=60_000)
    assert scans[0].header_stamp_ns == START + TURN // 2
    assert scans[0].end_ns - scans[0].stamp_ns == pytest.approx(TURN, rel=2e-3)


def make_sequence(folder, rng):
    (folder / "velodyne").mkdir(parents=True)
    for number in range(3):
        scan = np.concatenate([ring(np.linspace(np.pi, -np.pi, 2000))] * 2)
        scan[:, 2] = rng.normal(size=len(scan))
        scan.tofile(folder / "velodyne" / f"{number:06d}.bin")
    (folder / "times.txt").write_text("0.000000e+00\n1.037359e-01\n2.073779e-01\n")
    return folder


def test_odometry_sequence_is_not_deskewed_again(tmp_path, rng):
    folder = make_sequence(tmp_path / "00", rng)
    with open_recording(folder) as recording:
        scans = list(recording.stream())
        codes = {event.code for event in recording.events}
    assert [scan.header_stamp_ns for scan in scans] == [0, 103_735_900, 207_377_900]
    assert not any(scan.offsets_ns.any() for scan in scans)
    assert "already-deskewed" in codes
    assert not codes & {"no-point-time", "no-stamps"}


def test_odometry_sequence_with_few_stamps_is_refused(tmp_path, rng):
    folder = make_sequence(tmp_path / "00", rng)
    (folder / "times.txt").write_text("0.0\n")
    with pytest.raises(FormatError, match="has 1 stamps, but there is a scan of number 2"):
        open_kitti([folder])


def test_other_paths_are_not_kitti(tmp_path):
    (tmp_path / "file").touch()
    assert open_kitti([tmp_path]) is None
    assert open_kitti([tmp_path / "file"]) is None
    assert open_kitti([tmp_path, tmp_path]) is None
