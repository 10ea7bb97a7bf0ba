import struct

import numpy as np
import pytest

from heliograph.errors import FormatError, OutputError
from heliograph.maps import GlobalMap
from heliograph.output.submaps import Submap, SubmapFile, read_submaps, read_voxel
from states import random_pose


def make_submap(rng, *, count=200, spread=5.0, intensity=True, repeats=1, voxel=0.2):
    grown = GlobalMap(voxel)
    cloud = rng.uniform(-spread, spread, (count, 3)).astype(np.float32)
    values = rng.uniform(0.0, 255.0, count).astype(np.float32) if intensity else None
    for _ in range(repeats):
        grown.insert(cloud, values, np.eye(4))
    return Submap(stamp_ns=int(rng.integers(1 << 60)), T_odom_imu=random_pose(rng, 3.0), cells=grown.cells())


def assert_equal(a, b):
    assert a.stamp_ns == b.stamp_ns
    np.testing.assert_array_equal(a.T_odom_imu, b.T_odom_imu)
    for name in ("cubes", "sums", "intensity", "counts"):
        np.testing.assert_array_equal(getattr(a.cells, name), getattr(b.cells, name), err_msg=name)


def written(path, submaps, voxel=0.2):
    file = SubmapFile(path, voxel)
    for submap in submaps:
        file.append(submap)
    file.close()
    return file


def test_submaps_come_back_bit_by_bit(rng, tmp_path):
    submaps = [
        make_submap(rng),
        make_submap(rng, intensity=False),
        make_submap(rng, spread=9000.0),  # more than 65 536 cubes across
        make_submap(rng, count=3, repeats=70_000),  # more points in a cube than two bytes count
        make_submap(rng, count=0),
    ]
    file = written(tmp_path / "submaps.bin", submaps)
    assert file.nbytes == (tmp_path / "submaps.bin").stat().st_size and read_voxel(file.path) == 0.2
    found = list(read_submaps(file.path))
    assert len(found) == file.count == 5
    for a, b in zip(found, submaps, strict=True):
        assert_equal(a, b)


@pytest.mark.parametrize(("intensity", "size"), [(True, 24), (False, 20)])
def test_submaps_take_few_bytes_a_cube(rng, tmp_path, intensity, size):
    submap = make_submap(rng, count=5000, intensity=intensity)
    file = written(tmp_path / "submaps.bin", [submap])
    assert file.nbytes <= size * len(submap.cells) + 260


def test_submaps_cut_anywhere_leave_the_whole_ones(rng, tmp_path):
    submaps = [make_submap(rng, count=5) for _ in range(3)]
    path = written(tmp_path / "submaps.bin", submaps).path
    whole = path.read_bytes()
    ends = [written(tmp_path / "part.bin", submaps[:n]).nbytes for n in range(4)]
    for size in range(ends[0], len(whole)):
        path.write_bytes(whole[:size])
        assert len(list(read_submaps(path))) == sum(end <= size for end in ends[1:])


def test_submaps_with_a_wrong_byte_end_before_it(rng, tmp_path):
    path = written(tmp_path / "submaps.bin", [make_submap(rng), make_submap(rng)]).path
    damaged = bytearray(path.read_bytes())
    damaged[-3] ^= 1
    path.write_bytes(damaged)
    assert len(list(read_submaps(path))) == 1


def test_submaps_of_another_file_are_refused(tmp_path):
    with pytest.raises(FormatError, match="check the path"):
        read_voxel(tmp_path / "none.bin")
    (tmp_path / "other.bin").write_bytes(b"ply\nformat ascii 1.0\n")
    with pytest.raises(FormatError, match="no file of submaps"):
        list(read_submaps(tmp_path / "other.bin"))
    (tmp_path / "short.bin").write_bytes(struct.pack("<8s", b"HGSUBM01"))
    with pytest.raises(FormatError, match="no file of submaps"):
        read_voxel(tmp_path / "short.bin")


def test_submaps_half_written_are_cut_off(rng, tmp_path, full_disk):
    file = SubmapFile(tmp_path / "submaps.bin", 0.2)
    file.append(make_submap(rng, count=5))
    with full_disk(file.nbytes + 500), pytest.raises(OutputError, match=r"cannot write .*submaps\.bin"):
        file.append(make_submap(rng, count=1000))
    assert file.path.stat().st_size == file.nbytes
    file.append(make_submap(rng, count=5))
    file.close()
    assert len(list(read_submaps(file.path))) == 2


@pytest.mark.parametrize("count", [6, 0x10000, 0xF0000000])
def test_a_count_beyond_the_file_is_a_submap_cut_off(rng, tmp_path, count):
    """A forged count once made the reader ask for as much memory as it said."""
    path = written(tmp_path / "submaps.bin", [make_submap(rng, count=5)]).path
    content = bytearray(path.read_bytes())
    at = struct.calcsize("<8sd") + 4  # behind the file's head and the checksum
    assert struct.unpack_from("<I", content, at)[0] == 5
    struct.pack_into("<I", content, at, count)
    path.write_bytes(content)
    assert list(read_submaps(path)) == []
