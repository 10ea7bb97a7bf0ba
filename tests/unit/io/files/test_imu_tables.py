"""IMU tables: columns found by name or by physics."""

import numpy as np
import pytest

from heliograph.errors import FormatError
from heliograph.io.files.imu_tables import read_imu_table

GYRO = np.array([[0.01, 0.02, 0.03], [0.04, 0.05, 0.06], [0.07, 0.08, 0.09]])
ACCEL = np.array([[0.1, 0.2, 9.8], [0.3, 0.4, 9.7], [0.5, 0.6, 9.9]])
STAMPS = 1_700_000_000_000_000_000 + np.arange(3) * 5_000_000


def table(header, columns, separator=","):
    rows = [separator.join(str(value) for value in row) for row in zip(*columns, strict=True)]
    return "\n".join([header, *rows] if header else rows) + "\n"


def gyro_first(separator=","):
    return table("", [STAMPS, *GYRO.T, *ACCEL.T], separator)


@pytest.mark.parametrize(
    "header",
    [
        "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z",
        "timestamp,gx,gy,gz,ax,ay,az",
        "# t, wx, wy, wz, acc_x, acc_y, acc_z",
        "stamp,angular_velocity.x,angular_velocity.y,angular_velocity.z,"
        "linear_acceleration.x,linear_acceleration.y,linear_acceleration.z",
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
        "Time,omegaX,omegaY,omegaZ,accelX,accelY,accelZ",
        "timestamp_ns,GyroX,GyroY,GyroZ,AccX,AccY,AccZ",
        "imu.header.stamp,imu.gyro.x,imu.gyro.y,imu.gyro.z,imu.acc.x,imu.acc.y,imu.acc.z",
    ],
)
def test_imu_columns_are_found_by_their_names(tmp_path, header):
    (tmp_path / "imu.csv").write_text(table(header, [STAMPS, *GYRO.T, *ACCEL.T]))
    read = read_imu_table(tmp_path / "imu.csv")
    np.testing.assert_array_equal(read.stamps_ns, STAMPS)
    np.testing.assert_array_equal(read.gyro, GYRO)
    np.testing.assert_array_equal(read.accel, ACCEL)
    assert read.bad_rows == 0


def test_imu_columns_in_another_order_with_others_between(tmp_path):
    seconds = [f"{s // 10**9}.{s % 10**9:09d}" for s in STAMPS]
    columns = [[1, 2, 3], ACCEL[:, 2], *GYRO.T, ACCEL[:, 0], seconds, ACCEL[:, 1]]
    (tmp_path / "imu.txt").write_text(table("seq;az;gx;gy;gz;ax;time;ay", columns, ";"))
    read = read_imu_table(tmp_path / "imu.txt")
    np.testing.assert_array_equal(read.stamps_ns, STAMPS)
    np.testing.assert_array_equal(read.gyro, GYRO)
    np.testing.assert_array_equal(read.accel, ACCEL)


@pytest.mark.parametrize("separator", [",", " ", "\t"])
@pytest.mark.parametrize("scale", [1.0, 1 / 9.80665])
def test_imu_columns_without_header_are_told_apart_by_gravity(tmp_path, separator, scale):
    for name, columns in (("a", [*GYRO.T, *(ACCEL * scale).T]), ("b", [*(ACCEL * scale).T, *GYRO.T])):
        (tmp_path / name).write_text(table("", [STAMPS, *columns], separator))
        read = read_imu_table(tmp_path / name)
        np.testing.assert_array_equal(read.gyro, GYRO)
        np.testing.assert_allclose(read.accel, ACCEL * scale, rtol=1e-15)
        assert "median length" in read.evidence


def test_imu_rows_that_are_incomplete_are_counted_and_left_out(tmp_path):
    text = table("t,gx,gy,gz,ax,ay,az", [STAMPS, *GYRO.T, *ACCEL.T])
    (tmp_path / "imu.csv").write_text(
        text + "1700000000,1,2\n1700000001000000000,nan,0,0,0,0,0\nx,0,0,0,0,0,0\n# end\n"
    )
    read = read_imu_table(tmp_path / "imu.csv")
    assert len(read.stamps_ns) == 3
    assert read.bad_rows == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,gx,gy,gz\n0,1,2,3\n", "has no columns for accel"),
        ("a,b,c\n1,2,3\n", "has no columns for gyro, accel, time"),
        ("0 1 2 3\n", "not seven columns"),
        ("time,gx,gy,gz,ax,ay,az\n", "no complete row"),
        ("", "not seven columns"),
    ],
)
def test_imu_table_mistakes_are_format_errors(tmp_path, text, message):
    (tmp_path / "imu.csv").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_imu_table(tmp_path / "imu.csv")


def test_imu_table_of_the_public_drive(shared_data):
    read = read_imu_table(shared_data / "kitti_00" / "imu.txt")
    assert np.median(np.diff(read.stamps_ns)) == pytest.approx(10_000_000, rel=0.02)
    assert np.median(np.linalg.norm(read.accel, axis=1)) == pytest.approx(9.81, abs=0.2)
    assert np.median(np.linalg.norm(read.gyro, axis=1)) < 0.2
