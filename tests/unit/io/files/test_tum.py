"""TUM and KITTI trajectories: exact stamps, whole rows, errors with line numbers."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from heliograph.data import Trajectory
from heliograph.errors import FormatError, OutputError
from heliograph.io.files.tum import TumWriter, parse_seconds, read_kitti, read_tum, write_tum

SECONDS = 1_000_000_000
int64_stamps = st.integers(min_value=-(1 << 62), max_value=1 << 62)


def poses(rng, count):
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = rng.normal(scale=1000.0, size=(count, 3))
    return T


def trajectory(rng, count=50):
    stamps = np.int64(1_700_000_000 * SECONDS) + np.sort(rng.integers(0, 10**12, count))
    return Trajectory(stamps_ns=stamps, T_frame_body=poses(rng, count))


def test_tum_round_trip_is_exact_in_time_and_below_a_nanometre(tmp_path, rng):
    written = trajectory(rng)
    write_tum(tmp_path / "a.tum", written, "frame map")
    read = read_tum(tmp_path / "a.tum", frame="odom", body="imu")
    np.testing.assert_array_equal(read.stamps_ns, written.stamps_ns)
    np.testing.assert_allclose(read.T_frame_body[:, :3, 3], written.T_frame_body[:, :3, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(read.T_frame_body[:, :3, :3], written.T_frame_body[:, :3, :3], rtol=0, atol=1e-11)


def test_tum_first_line_is_one_comment(tmp_path, rng):
    write_tum(tmp_path / "a.tum", trajectory(rng, 2), "T_map_imu; stamps:\nheader stamps; heliograph 0.1.0")
    lines = (tmp_path / "a.tum").read_text().splitlines()
    assert lines[0] == "# T_map_imu; stamps: header stamps; heliograph 0.1.0"
    assert [len(line.split()) for line in lines[1:]] == [8, 8]


def test_tum_quaternions_are_scalar_last_with_positive_scalar(tmp_path, rng):
    written = trajectory(rng)
    write_tum(tmp_path / "a.tum", written, "x")
    rows = np.loadtxt(tmp_path / "a.tum")
    expected = Rotation.from_matrix(written.T_frame_body[:, :3, :3]).as_quat(canonical=True)
    np.testing.assert_allclose(rows[:, 4:], expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi - 1e-9, np.pi])
def test_tum_rotation_survives_at_small_and_half_turns(tmp_path, axis, angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    with TumWriter(tmp_path / "a.tum", "x") as writer:
        writer.append(0, T)
    np.testing.assert_allclose(read_tum(tmp_path / "a.tum").T_frame_body[0], T, rtol=0, atol=1e-11)


@given(stamp=int64_stamps)
def test_tum_stamp_round_trip_is_exact(tmp_path_factory, stamp):
    path = tmp_path_factory.getbasetemp() / "stamp.tum"
    with TumWriter(path, "x") as writer:
        writer.append(stamp, np.eye(4))
    assert read_tum(path).stamps_ns[0] == stamp


@given(stamp=int64_stamps, digits=st.integers(min_value=0, max_value=9))
def test_parse_seconds_agrees_with_integer_arithmetic(stamp, digits):
    shortened = stamp - stamp % 10 ** (9 - digits)
    sign, magnitude = ("-", -shortened) if shortened < 0 else ("", shortened)
    text = f"{sign}{magnitude // SECONDS}.{magnitude % SECONDS:09d}"[: None if digits == 9 else digits - 9]
    assert parse_seconds(text.rstrip(".") if digits == 0 else text) == shortened


@pytest.mark.parametrize(
    ("text", "expected"),
    [("1.5e9", 1_500_000_000 * SECONDS), ("7", 7 * SECONDS), (".5", SECONDS // 2), ("1.0000000009", SECONDS + 1)],
)
def test_parse_seconds_reads_every_decimal_notation(text, expected):
    assert parse_seconds(text) == expected


@pytest.mark.parametrize("text", ["", "nan", "inf", "1,5", "abc", "0x10", "1.2.3", "--1.0", "1e30"])
def test_parse_seconds_refuses_what_is_no_number(text):
    with pytest.raises(ValueError, match="seconds"):
        parse_seconds(text)


GOOD = "1.0 0 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD + "2.0 0 0 0 0 0 1\n", "line 2 has 7 values"),
        ("# c\n\n" + GOOD + "2.0 0 x 0 0 0 0 1\n", "line 4 holds something that is not a number"),
        (GOOD + "2.0 0 nan 0 0 0 0 1\n", "line 2 holds a value that is not finite"),
        (GOOD + "2.0 0 0 0 0 0 0 0\n", "line 2 has a quaternion"),
        (GOOD + "0.5 0 0 0 0 0 0 1\n", "line 2 is 0.500000 s before line 1"),
        ("# only a comment\n", "holds no poses"),
    ],
)
def test_read_tum_names_the_faulty_line(tmp_path, text, message):
    path = tmp_path / "bad.tum"
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        read_tum(path)


def test_read_tum_refuses_binary_and_missing_files(tmp_path):
    (tmp_path / "a.tum").write_bytes(b"\x00\xff\xfe")
    with pytest.raises(FormatError, match="not a text file"):
        read_tum(tmp_path / "a.tum")
    with pytest.raises(FormatError, match="cannot be read"):
        read_tum(tmp_path / "missing.tum")


def test_read_tum_takes_commas_and_comments_after_rows(tmp_path):
    (tmp_path / "a.csv").write_text("1.25,1,2,3,0,0,0,1 # first\n")
    read = read_tum(tmp_path / "a.csv")
    assert read.stamps_ns[0] == 1_250_000_000
    np.testing.assert_array_equal(read.T_frame_body[0, :3, 3], [1, 2, 3])


def test_tum_writer_keeps_rows_that_were_flushed(tmp_path, rng):
    writer = TumWriter(tmp_path / "a.tum", "x")
    T = poses(rng, 3)
    writer.append(1, T[0])
    writer.flush()
    assert len(read_tum(tmp_path / "a.tum")) == 1
    writer.extend(np.array([2, 3]), T[1:])
    writer.close()
    writer.close()
    assert len(read_tum(tmp_path / "a.tum")) == 3


def test_tum_writer_refuses_poses_that_do_not_fit_the_stamps(tmp_path):
    with TumWriter(tmp_path / "a.tum", "x") as writer, pytest.raises(ValueError, match="shape"):
        writer.extend(np.array([1, 2]), np.eye(4)[None])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_tum_writer_reports_a_full_disk():
    with pytest.raises(OutputError, match="disk is full"):
        TumWriter("/dev/full", "x")


def test_read_kitti_takes_matrices_and_times(tmp_path, rng):
    T = poses(rng, 4)
    np.savetxt(tmp_path / "poses.txt", T[:, :3].reshape(4, 12), fmt="%.17g")
    (tmp_path / "times.txt").write_text("0.0\n0.1\n2.000000001e-1\n0.3\n")
    read = read_kitti(tmp_path / "poses.txt", tmp_path / "times.txt")
    np.testing.assert_array_equal(read.stamps_ns, [0, 100_000_000, 200_000_000, 300_000_000])
    np.testing.assert_allclose(read.T_frame_body, T, rtol=0, atol=1e-12)
    assert read_kitti(tmp_path / "poses.txt").stamps_ns[-1] == 3 * SECONDS


def test_read_kitti_names_the_faulty_line(tmp_path, rng):
    T = poses(rng, 3)
    rows = T[:, :3].reshape(3, 12)
    np.savetxt(tmp_path / "poses.txt", rows)
    with pytest.raises(FormatError, match="3 poses, but there are 2 stamps"):
        read_kitti(tmp_path / "poses.txt", np.array([0, 1]))
    rows[1, 0] += 0.1
    np.savetxt(tmp_path / "poses.txt", rows)
    with pytest.raises(FormatError, match="line 2 holds a matrix whose left 3x3 block is no rotation"):
        read_kitti(tmp_path / "poses.txt")
    np.savetxt(tmp_path / "poses.txt", rows[:, :11])
    with pytest.raises(FormatError, match="line 1 has 11 values"):
        read_kitti(tmp_path / "poses.txt")


def test_read_kitti_reads_the_public_sequence(shared_data):
    read = read_kitti(
        shared_data / "kitti_00" / "groundtruth_kitti.txt", shared_data / "kitti_00" / "groundtruth_times.txt"
    )
    length = np.linalg.norm(np.diff(read.T_frame_body[:, :3, 3], axis=0), axis=1).sum()
    assert len(read) == 4541
    assert length == pytest.approx(3724, abs=5)
