"""Fixes beside a recording: NMEA, RTKLIB and CSV say the same, and what is wrong is told with its line."""

import numpy as np
import pytest

from heliograph.errors import FormatError
from heliograph.io.files.fixes import read_fixes

STAMP_NS = 1_750_000_000_500_000_000  # 2025-06-15 15:06:40.5 UTC


def nmea(*bodies):
    def line(body):
        total = 0
        for letter in body:
            total ^= ord(letter)
        return f"${body}*{total:02X}"

    return "\r\n".join(line(body) for body in bodies) + "\r\n"


NMEA = nmea(
    "GPRMC,150640.50,A,5207.407380,N,01124.000000,E,0.0,0.0,150625,,,A",
    "GPGST,150640.50,1.0,1.0,1.0,0.0,0.020,0.010,0.030",
    "GPGGA,150640.50,5207.407380,N,01124.000000,E,4,12,0.8,40.000,M,45.000,M,,",
)
POS = (
    "% program : rnx2rtkp\n%  GPST  latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne sdeu sdun\n"
    "2025/06/15 15:06:58.500   52.123456333   11.400000000    85.0000   1   9   0.0200   0.0100   0.0300  0 0 0 0 0\n"
)
CSV = (
    "stamp,latitude,longitude,height,sigma_east,sigma_north,sigma_up,solution\n"
    "1750000000.5,52.123456333,11.4,85.0,0.01,0.02,0.03,fixed\n"
)
SEMICOLONS = CSV.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(("name", "text"), [("a.nmea", NMEA), ("a.pos", POS), ("a.csv", CSV), ("b.csv", SEMICOLONS)])
def test_all_formats_say_the_same(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    (fix,) = read_fixes(path)
    assert fix.stamp_ns == STAMP_NS
    assert (fix.latitude_deg, fix.longitude_deg, fix.altitude) == pytest.approx((52.123456333, 11.4, 85.0), abs=1e-8)
    assert fix.solution == "fixed"
    np.testing.assert_allclose(np.sqrt(np.diag(fix.covariance_enu)), [0.01, 0.02, 0.03])


def test_nmea_without_a_date_takes_the_recordings_day(tmp_path):
    path = tmp_path / "a.nmea"
    path.write_text("".join(NMEA.splitlines(keepends=True)[1:]))
    with pytest.raises(FormatError, match="without a date"):
        read_fixes(path)
    assert read_fixes(path, near_ns=STAMP_NS + 3600 * 10**9)[0].stamp_ns == STAMP_NS


def test_nmea_sentence_with_a_wrong_checksum_is_left_out(tmp_path):
    path = tmp_path / "a.nmea"
    path.write_text(NMEA + NMEA.splitlines()[-1].replace("5207", "5307") + "\n")
    assert len(read_fixes(path)) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stamp,latitude,longitude,height\n1,52,1,11,4,80,0\n", "decimal commas"),
        ("stamp,latitude,longitude\n1,52.1,11.4\n", "no column height"),
        ("stamp,latitude,longitude,height\n1,north,11.4,80\n", "line 2: latitude is 'north'"),
        ("stamp,latitude,longitude,height\n1e302,52.1,11.4,80\n", "line 2: its time is beyond any clock's"),
        ("stamp,latitude,longitude,height\n1e300,52.1,11.4,80\n1,52.1,11.4,80\n1,52.1,11.4,80\n", "line 2: its time"),
        ("stamp,latitude,longitude,height\n", "holds no fix"),
        ("1,52.1,11.4,80\n", "no header"),
        ("", "is empty"),
    ],
)
def test_files_that_cannot_be_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(FormatError, match=message) as caught:
        read_fixes(path)
    assert "\n" not in str(caught.value)


def test_nmea_accuracy_that_is_no_number_names_its_line(tmp_path):
    path = tmp_path / "fixes.nmea"
    path.write_text("$GPGST,150640.50,,,,,0.x4,0.02,0.03\n$GPZDA,150640.50,15,06,2025,00,00\n")
    with pytest.raises(FormatError, match="line 1 is no valid GST"):
        read_fixes(path)
