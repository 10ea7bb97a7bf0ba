"""Coordinate systems, LAS and tracks: there and back to a millimetre, header fields as the specification has them."""

import json
import struct
from types import SimpleNamespace

import numpy as np
import pytest

from heliograph.errors import ConfigError, DataError
from heliograph.geodesy import geodetic_to_enu
from heliograph.lie import se3
from heliograph.survey.coordinates import find_coordinate_system
from heliograph.survey.las import adjusted_gps_time, write_survey_las, write_survey_tiles
from heliograph.survey.sbet import read_rows, write_sbet, write_smrmsg
from heliograph.survey.tracks import SurveyTrack, write_csv_track, write_gpx_track, write_kml_track

pyproj = pytest.importorskip("pyproj")
laspy = pytest.importorskip("laspy")

ORIGIN_DEG = np.array([52.0, 11.0, 80.0])
STAMP_NS = 1_750_000_000_000_000_000


@pytest.mark.parametrize("name", ["utm", "local", "EPSG:25832", "EPSG:3035"])
def test_positions_come_back_to_a_millimetre(name, rng):
    system = find_coordinate_system(name, ORIGIN_DEG)
    p = rng.uniform(-3000.0, 3000.0, (200, 3)) * [1.0, 1.0, 0.02]
    np.testing.assert_allclose(system.to_enu(system.from_enu(p)), p, atol=1e-3)


def test_utm_is_what_pyproj_makes_of_the_geodetic_place():
    system = find_coordinate_system("utm", ORIGIN_DEG)
    expected = pyproj.Transformer.from_crs(4979, 32632, always_xy=True).transform(11.0, 52.0, 80.0)
    np.testing.assert_allclose(system.from_enu(np.zeros((1, 3)))[0], expected, atol=1e-3)
    assert system.tag == "epsg32632"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("EPSG:99999", "no coordinate system"),
        ("EPSG:4326", "choose one in metres"),
        ("nonsense", "no coordinate system"),
    ],
)
def test_systems_that_cannot_be_are_refused_in_one_line(name, message):
    with pytest.raises(ConfigError, match=message) as caught:
        find_coordinate_system(name, ORIGIN_DEG)
    assert "\n" not in str(caught.value)


def test_point_of_another_place_is_refused():
    system = find_coordinate_system("EPSG:25832", ORIGIN_DEG)
    with pytest.raises(ConfigError, match="km from the run"):
        system.to_enu(np.array([[5_700_000.0, 600_000.0, 80.0]]))  # northing first


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_reads_back_with_its_system(tmp_path, rng, suffix):
    system = find_coordinate_system("utm", ORIGIN_DEG)
    p = system.from_enu(rng.uniform(-500.0, 500.0, (1000, 3)))
    stamps = STAMP_NS + np.arange(1000) * 10**7
    path = tmp_path / f"map{suffix}"
    write_survey_las(path, p, rng.uniform(0.0, 255.0, 1000).astype(np.float32), stamps, system, "Heliograph test")
    las = laspy.read(path)
    np.testing.assert_allclose(las.xyz, p, atol=0.51e-3)
    np.testing.assert_allclose(las.gps_time, adjusted_gps_time(stamps), atol=1e-6)
    assert las.header.parse_crs().to_epsg() == 32632
    assert las.header.point_format.id == 6
    assert (np.asarray(las.return_number) == 1).all()
    assert np.asarray(las.intensity).max() > 60_000


def test_las_header_is_as_the_specification_has_it(tmp_path, rng):
    """ASPRS LAS 1.4 R15, table 3."""
    path, system = tmp_path / "map.las", find_coordinate_system("utm", ORIGIN_DEG)
    p = system.from_enu(rng.uniform(-500.0, 500.0, (10, 3)))
    write_survey_las(path, p, None, np.full(10, STAMP_NS), system, "Heliograph test")
    head = path.read_bytes()[:375]
    assert head[:4] == b"LASF"
    encoding, major, minor = struct.unpack_from("<H", head, 6)[0], head[24], head[25]
    assert (major, minor) == (1, 4)
    assert encoding & 1, "adjusted standard GPS time"
    assert encoding & 16, "WKT, which point formats 6 to 10 demand"
    size, to_points, records, kind, length = struct.unpack_from("<HIIBH", head, 94)
    assert (size, kind, length) == (375, 6, 30)
    assert records >= 1
    assert to_points > 375
    assert struct.unpack_from("<I", head, 107)[0] == 0, "legacy count of a format that has none"
    assert struct.unpack_from("<3d", head, 131) == (0.001, 0.001, 0.001)
    assert struct.unpack_from("<Q", head, 247)[0] == 10


def test_las_refuses_what_it_cannot_hold(tmp_path):
    system = find_coordinate_system("local", ORIGIN_DEG)
    with pytest.raises(DataError, match="not finite"):
        write_survey_las(tmp_path / "a.las", np.full((2, 3), np.nan), None, np.zeros(2, np.int64), system, "")
    assert not (tmp_path / "a.las").exists()


def test_adjusted_gps_time_of_a_known_instant():
    """2025-06-15 15:06:40 UTC is second 1434035218 of GPS time."""
    assert adjusted_gps_time(np.array([STAMP_NS]))[0] == pytest.approx(1_434_035_218.0 - 1e9)


def test_tracks_hold_the_same_way(tmp_path):
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, 0, 3] = np.arange(30.0)
    T = T @ se3.exp(np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]))
    stamps = STAMP_NS + np.arange(30) * 10**8
    track = SurveyTrack(stamps_ns=stamps, T_enu_body=T, sigma=np.full((30, 3), 0.02), sigma_heading=np.full(30, 1e-3))
    system = find_coordinate_system("utm", ORIGIN_DEG)
    write_csv_track(tmp_path / "a.csv", track, system)
    rows = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=2)
    np.testing.assert_allclose(rows[:, 1:4], system.from_enu(T[:, :3, 3]), atol=1e-4)
    np.testing.assert_allclose(rows[:, 4] % 360.0, 0.0, atol=1e-4)  # looks north
    write_gpx_track(tmp_path / "a.gpx", track, system.origin)
    write_kml_track(tmp_path / "a.kml", track, system.origin)
    assert (tmp_path / "a.gpx").read_text().count("<trkpt") == 3
    assert "11.0" in (tmp_path / "a.kml").read_text()


def turning_track(count=60):
    """A way north-east that begins level and turns left while it climbs, ten poses a second."""
    T = np.tile(np.eye(4), (count, 1, 1))
    for k in range(1, count):
        T[k] = T[k - 1] @ se3.exp(np.array([0.0, -0.002, 0.01, 0.5, 0.0, 0.0]))
    T = se3.exp(np.array([0.0, 0.0, np.pi / 4, 0.0, 0.0, 0.0])) @ T
    sigma = np.tile([0.02, 0.03, 0.05], (count, 1))
    stamps = STAMP_NS + np.arange(count) * 10**8
    return SurveyTrack(stamps_ns=stamps, T_enu_body=T, sigma=sigma, sigma_heading=np.full(count, np.radians(0.1)))


def test_sbet_holds_the_way_its_angles_and_its_motion(tmp_path):
    track, origin = turning_track(), np.array([np.radians(52.0), np.radians(11.0), 80.0])
    write_sbet(tmp_path / "a.sbet", track, origin)
    assert (tmp_path / "a.sbet").stat().st_size == 60 * 17 * 8
    rows = read_rows(tmp_path / "a.sbet", 17)
    np.testing.assert_allclose(rows[:, 0], 1_434_035_218.0 % 604_800.0 + 0.1 * np.arange(60), atol=1e-6)
    back = geodetic_to_enu(rows[:, 1:4], origin)
    np.testing.assert_allclose(back, track.T_enu_body[:, :3, 3], atol=1e-3)
    np.testing.assert_allclose(rows[0, 7:10], [0.0, 0.0, np.pi / 4], atol=1e-6)  # level, to the north-east
    assert rows[30, 9] < rows[0, 9]  # a turn to the left
    assert rows[30, 8] > 0.0  # the nose goes up
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:7], axis=1), 5.0, rtol=1e-3)
    assert rows[30, 6] < 0.0  # upwards, and z is down
    np.testing.assert_allclose(rows[:, 14:], np.tile([0.0, 0.02, -0.1], (60, 1)), atol=1e-9)


def test_smrmsg_holds_the_sigmas_north_first(tmp_path):
    track = turning_track()
    write_smrmsg(tmp_path / "a.smrmsg", track, np.zeros(3))
    rows = read_rows(tmp_path / "a.smrmsg", 10)
    np.testing.assert_allclose(rows[0, 1:4], [0.03, 0.02, 0.05])
    np.testing.assert_allclose(rows[:, 9], 6.0)


def test_tiles_hold_each_point_once_and_the_index_tells_where(tmp_path, rng):
    system = find_coordinate_system("utm", ORIGIN_DEG)
    p = system.from_enu(rng.uniform(-150.0, 150.0, (2000, 3)))
    stamps, intensity = np.full(2000, STAMP_NS), rng.uniform(0.0, 255.0, 2000).astype(np.float32)
    files = write_survey_tiles(tmp_path / "map", 100.0, p, intensity, stamps, system, "test")
    index = json.loads(files[-1].read_text())
    assert [tmp_path / "map" / tile["file"] for tile in index["tiles"]] == files[:-1]
    assert sum(tile["points"] for tile in index["tiles"]) == 2000
    read = np.concatenate([laspy.read(path).xyz for path in files[:-1]])
    assert len(np.unique(np.round(read, 3), axis=0)) == len(np.unique(np.round(p, 3), axis=0))
    for tile, path in zip(index["tiles"], files[:-1], strict=True):
        corner = np.array([float(number) for number in path.stem.split("_")])
        inside = laspy.read(path).xyz[:, :2] - corner
        assert inside.min() >= -1e-3
        assert inside.max() <= 100.0 + 1e-3
        assert tile["min"][0] >= corner[0]


def test_e57_has_a_station_a_keyframe_with_its_pose(tmp_path, rng):
    pye57 = pytest.importorskip("pye57")
    from heliograph.survey.e57 import station_poses, write_survey_e57

    system = find_coordinate_system("utm", ORIGIN_DEG)
    T_enu = se3.exp(rng.normal(size=(3, 6)) * [0.1, 0.1, 1.0, 50.0, 50.0, 1.0])
    clouds = [rng.normal(size=(40, 3)).astype(np.float32) for _ in range(3)]
    keyframes = [SimpleNamespace(index=k, stamp_ns=k, points_imu=clouds[k], intensity=None) for k in range(3)]
    T = station_poses(T_enu, system)
    write_survey_e57(tmp_path / "map.e57", keyframes, T, system)
    file = pye57.E57(str(tmp_path / "map.e57"))
    assert file.scan_count == 3
    assert pyproj.CRS.from_wkt(file.root["coordinateMetadata"].value()).to_epsg() == 32632
    for k in range(3):
        read = file.read_scan(k, ignore_missing_fields=True)
        found = np.stack([read[f"cartesian{axis}"] for axis in "XYZ"], axis=-1)
        expected = system.from_enu(se3.act(T_enu[k], clouds[k].astype(np.float64)))
        np.testing.assert_allclose(found, expected, atol=4e-3)  # the projection's scale, 4e-4 of metres
        np.testing.assert_allclose(file.get_header(k).translation, T[k, :3, 3], atol=1e-6)
    file.close()
