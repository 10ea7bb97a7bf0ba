"""Cloud files: round trips in every encoding, damage, and a full disk."""

import struct
import sys
from pathlib import Path

import lzf
import numpy as np
import pytest

from heliograph.errors import DataError, FormatError, MissingDependencyError, OutputError
from heliograph.io.files.clouds import read_cloud, read_columns, write_cloud
from heliograph.io.files.ply import write_ply


@pytest.fixture
def points(rng):
    points = rng.normal(scale=50.0, size=(1000, 3)).astype(np.float32)
    points[7] = np.nan
    return points


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".PLY"])
def test_cloud_round_trip_keeps_every_bit_and_type(tmp_path, points, rng, suffix):
    intensity = rng.random(1000, dtype=np.float32)
    columns = {
        "t": np.arange(1000, dtype=np.uint32) * 100_000,
        "ring": (np.arange(1000) % 64).astype(np.uint16),
        "stamp": 1.7e9 + np.arange(1000) * 1e-6,
    }
    path = tmp_path / f"a{suffix}"
    write_cloud(path, points, intensity, columns, comments=["first\nline", "µ"])
    read = read_cloud(path)
    np.testing.assert_array_equal(read.points, points)
    np.testing.assert_array_equal(read.intensity, intensity)
    assert list(read.columns) == ["t", "ring", "stamp"]
    for name, column in columns.items():
        assert read.columns[name].dtype == column.dtype
        np.testing.assert_array_equal(read.columns[name], column)
    assert b"first line" in path.read_bytes()[:200]


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
@pytest.mark.parametrize("count", [0, 1, (1 << 18) + 3])
def test_cloud_round_trip_at_block_boundaries(tmp_path, suffix, count):
    points = np.arange(3 * count, dtype=np.float32).reshape(count, 3)
    write_cloud(tmp_path / f"a{suffix}", points)
    read = read_cloud(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(read.points, points)
    assert read.intensity is None


def test_pcd_keeps_64_bit_integers_and_ply_refuses_them(tmp_path, points):
    columns = {"timestamp": np.full(1000, 1_700_000_000_123_456_789, dtype=np.uint64)}
    write_cloud(tmp_path / "a.pcd", points, columns=columns)
    np.testing.assert_array_equal(read_columns(tmp_path / "a.pcd")["timestamp"], columns["timestamp"])
    with pytest.raises(DataError, match="timestamp is uint64, which PLY cannot hold"):
        write_cloud(tmp_path / "a.ply", points, columns=columns)
    assert not (tmp_path / "a.ply").exists()


PCD_HEADER = (
    "VERSION 0.7\nFIELDS x y z _ normal i timestamp\nSIZE 4 4 4 1 4 2 8\nTYPE F F F U F U U\nCOUNT 1 1 1 4 3 1 1\n"
    "WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA "
)
PCD_TYPE = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("_", "u1", 4), ("n", "<f4", 3), ("i", "<u2"), ("t", "<u8")]
)


def odd_pcd(encoding):
    records = np.zeros(2, dtype=PCD_TYPE)
    records["x"], records["y"], records["z"] = [1, 2], [3, 4], [5, np.nan]
    records["i"], records["t"] = [7, 65535], [1_700_000_000_123_456_789, 1]
    if encoding == "binary":
        body = records.tobytes()
    elif encoding == "binary_compressed":
        raw = b"".join(records[name].tobytes() for name in PCD_TYPE.names) + bytes(500)
        packed = lzf.compress(raw)
        body = struct.pack("<II", len(packed), len(raw)) + packed
    else:
        rows = ["1 3 5 0 0 0 0 0 0 0 7 1700000000123456789", "2 4 nan 0 0 0 0 0 0 0 65535 1"]
        body = "\n".join(rows).encode()
    return (PCD_HEADER + encoding + "\n").encode() + body


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd_is_read_in_every_encoding(tmp_path, encoding):
    (tmp_path / "a.pcd").write_bytes(odd_pcd(encoding))
    read = read_cloud(tmp_path / "a.pcd")
    np.testing.assert_array_equal(read.points, np.array([[1, 3, 5], [2, 4, np.nan]], dtype=np.float32))
    np.testing.assert_array_equal(read.intensity, [7, 65535])
    assert list(read.columns) == ["timestamp"]
    np.testing.assert_array_equal(read.columns["timestamp"], [1_700_000_000_123_456_789, 1])


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd_cut_short_is_a_format_error_at_every_length(tmp_path, encoding):
    whole = odd_pcd(encoding)
    for length in range(0, len(whole) - 1, 3):
        (tmp_path / "a.pcd").write_bytes(whole[:length])
        with pytest.raises(FormatError, match=r"a\.pcd: "):
            read_cloud(tmp_path / "a.pcd")


PLY_HEADER = (
    "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 2\n"
    "property float x\nproperty float32 y\nproperty double z\n"
    "property uchar reflectivity\nproperty uint t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
PLY_ROWS = [(1.0, 2.0, 3.0, 255, 4_294_967_295), (-1.0, float("nan"), 1e-3, 0, 0)]


def odd_ply(encoding):
    if encoding == "ascii":
        body = "\n".join(" ".join(str(value) for value in row) for row in PLY_ROWS).encode() + b"\n3 0 1 1\n"
    else:
        order = "<" if "little" in encoding else ">"
        body = b"".join(struct.pack(order + "ffdBI", *row) for row in PLY_ROWS) + struct.pack(
            order + "Biii", 3, 0, 1, 1
        )
    return PLY_HEADER.format(encoding).encode() + body


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_is_read_in_every_encoding(tmp_path, encoding):
    (tmp_path / "a.ply").write_bytes(odd_ply(encoding))
    read = read_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.points, np.array([[1, 2, 3], [-1, np.nan, 1e-3]], dtype=np.float32))
    np.testing.assert_array_equal(read.intensity, [255, 0])
    assert read.columns["t"].dtype == np.dtype(np.uint32)
    assert read.columns["t"].dtype.isnative
    np.testing.assert_array_equal(read.columns["t"], [4_294_967_295, 0])


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_cut_short_is_a_format_error_at_every_length(tmp_path, encoding):
    whole = odd_ply(encoding)
    face_bytes = 10 if encoding == "ascii" else 13
    for length in range(0, len(whole) - face_bytes - 2, 3):
        (tmp_path / "a.ply").write_bytes(whole[:length])
        with pytest.raises(FormatError, match=r"a\.ply: "):
            read_cloud(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n", "list property"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n", "unknown type 'quad'"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "no column y, z"),
        ("a.ply", b"ply\nnonsense\nend_header\n", "not PLY"),
        ("a.ply", b"ply\nelement vertex 0\nend_header\n", "without 'format'"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "without 'element vertex'"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement face 1\nelement vertex 1\nend_header\n", "'face' before 'vertex'"),
        ("a.pcd", b"FIELDS x\nSIZE 3\nTYPE F\nPOINTS 1\nDATA ascii\n1\n", "faulty PCD header"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nPOINTS -1\nDATA ascii\n1\n", "faulty PCD header"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nPOINTS 1\nDATA zip\n1\n", "none of ascii"),
        ("a.pcd", b"hello\n", "not a PCD file"),
        ("a.xyz", b"1 2 3\n", "not a cloud that can be read"),
    ],
)
def test_read_cloud_says_what_is_wrong(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError, match=message):
        read_cloud(tmp_path / name)


def test_read_cloud_of_a_missing_file_is_a_format_error(tmp_path):
    with pytest.raises(FormatError, match="cannot be read"):
        read_cloud(tmp_path / "a.ply")


def test_write_cloud_refuses_wrong_arrays_and_suffixes(tmp_path, points):
    with pytest.raises(DataError, match="float64"):
        write_cloud(tmp_path / "a.ply", points.astype(np.float64))
    with pytest.raises(DataError, match=r"expected \(1000,\)"):
        write_cloud(tmp_path / "a.ply", points, points[:5, 0].copy())
    with pytest.raises(OutputError, match=r"must be one of \.ply, \.pcd, \.las, \.laz"):
        write_cloud(tmp_path / "a.obj", points)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_write_cloud_on_a_full_disk_leaves_the_old_file(tmp_path, points, monkeypatch):
    path = tmp_path / "a.ply"
    path.write_text("old")
    full = Path("/dev/full")
    monkeypatch.setattr("heliograph.io.files.clouds._WRITERS", {".ply": lambda _, *rest: write_ply(full, *rest)})
    with pytest.raises(OutputError, match=r"a\.ply: the disk is full"):
        write_cloud(path, points)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_holds_millimetres_and_extra_columns(tmp_path, points, suffix):
    laspy = pytest.importorskip("laspy", reason="laspy is an extra: pip install heliograph[las]")
    finite = points[8:]
    intensity = np.linspace(0, 300, len(finite), dtype=np.float32)
    write_cloud(tmp_path / f"a{suffix}", finite, intensity, {"ring": np.arange(len(finite), dtype=np.uint16)})
    read = laspy.read(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(read.xyz, finite, rtol=0, atol=0.00051)
    np.testing.assert_array_equal(read.intensity, np.rint(intensity))
    np.testing.assert_array_equal(read["ring"], np.arange(len(finite)))
    assert read.header.global_encoding.wkt and set(read.return_number) == set(read.number_of_returns) == {1}


def test_las_refuses_nan(tmp_path, points):
    pytest.importorskip("laspy", reason="laspy is an extra: pip install heliograph[las]")
    with pytest.raises(DataError, match="1 of 1000 points are not finite"):
        write_cloud(tmp_path / "a.las", points)


def test_las_without_laspy_names_the_install_command(tmp_path, points, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'heliograph\[las\]'"):
        write_cloud(tmp_path / "a.laz", points)


def test_public_clouds_are_read(shared_data):
    for name in ("keyframes/hku_1/Scans/000000.pcd", "keyframes/kaist03/Scans/000008.pcd", "registration/source.ply"):
        read = read_cloud(shared_data / name)
        assert len(read) > 1000
        assert np.isfinite(read.points).all()
        assert 1.0 < np.abs(read.points).max() < 300.0
