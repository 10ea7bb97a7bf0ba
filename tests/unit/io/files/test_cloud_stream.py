"""Clouds written block by block read as those written at once."""

import numpy as np
import pytest

from heliograph.errors import DataError, OutputError
from heliograph.io.files.clouds import cloud_stream, read_cloud, write_cloud

TYPES = {**dict.fromkeys("xyz", np.dtype(np.float32)), "intensity": np.dtype(np.float32), "stamp": np.dtype(float)}


def blocks(rng, sizes=(5, 0, 1200, 7)):
    for size in sizes:
        x, y, z, intensity = rng.uniform(0.0, 90.0, (4, size)).astype(np.float32)
        yield {"x": x, "y": y, "z": z, "intensity": intensity, "stamp": 1.7e9 + rng.uniform(0.0, 1.0, size)}


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
def test_blocks_read_as_one_cloud(tmp_path, rng, suffix):
    parts = list(blocks(rng))
    with cloud_stream(tmp_path / f"map.{suffix}", TYPES, comments=["in blocks"]) as stream:
        for part in parts:
            stream.append(part)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in TYPES}
    cloud = read_cloud(tmp_path / f"map.{suffix}")
    np.testing.assert_array_equal(cloud.points, np.column_stack([joined[axis] for axis in "xyz"]))
    np.testing.assert_array_equal(cloud.intensity, joined["intensity"])
    np.testing.assert_array_equal(cloud.columns["stamp"], joined["stamp"])


@pytest.mark.parametrize("brightest", [90.0, 0.9])
def test_laz_blocks_are_those_of_one_cloud(tmp_path, rng, brightest):
    laspy = pytest.importorskip("laspy")
    parts = list(blocks(rng))
    for part in parts:
        part["intensity"] *= np.float32(brightest / 90.0)
    with cloud_stream(tmp_path / "map.laz", TYPES, brightest=brightest) as stream:
        for part in parts:
            stream.append(part)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in TYPES}
    points = np.column_stack([joined[axis] for axis in "xyz"])
    write_cloud(tmp_path / "once.laz", points, joined["intensity"], {"stamp": joined["stamp"]})
    streamed, once = laspy.read(tmp_path / "map.laz"), laspy.read(tmp_path / "once.laz")
    np.testing.assert_allclose(streamed.xyz, points, atol=6e-4)
    np.testing.assert_array_equal(streamed.intensity, once.intensity)
    np.testing.assert_array_equal(streamed["stamp"], joined["stamp"])


def test_double_coordinates_keep_their_millimetres(tmp_path):
    types = {**TYPES, **dict.fromkeys("xyz", np.dtype(float))}
    far = np.array([200_000.001, 200_000.002])
    with cloud_stream(tmp_path / "map.ply", types) as stream:
        stream.append({"x": far, "y": far, "z": far, "intensity": np.zeros(2, np.float32), "stamp": far})
    head = (tmp_path / "map.ply").read_bytes()
    assert b"property double x" in head and far[:1].tobytes() in head


def test_what_fails_leaves_no_file(tmp_path, rng):
    def fails():
        with cloud_stream(tmp_path / "map.ply", TYPES) as stream:
            stream.append(next(blocks(rng)))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fails()
    assert list(tmp_path.iterdir()) == []


def test_unknown_suffixes_and_odd_points_are_told(tmp_path):
    with pytest.raises(OutputError, match="suffix must be one of"), cloud_stream(tmp_path / "map.obj", TYPES):
        pass
    pytest.importorskip("laspy")
    odd = {name: np.full(1, np.nan, dtype) for name, dtype in TYPES.items()}
    with pytest.raises(DataError, match="not finite"), cloud_stream(tmp_path / "map.laz", TYPES) as stream:
        stream.append(odd)
