"""LAS and LAZ whose header or table of chunks is forged: refused before a decoder reserves memory by it."""

import struct

import numpy as np
import pytest

from heliograph.errors import FormatError
from heliograph.io.files.cloud_points import read_points
from heliograph.io.files.clouds import write_cloud
from heliograph.io.files.las_header import check_las

laspy = pytest.importorskip("laspy", reason="laspy is an extra: pip install heliograph[las]")


def written(path, rng):
    write_cloud(path, rng.uniform(-20.0, 20.0, (3000, 3)).astype(np.float32), None)
    return bytearray(path.read_bytes())


def compression(content):
    """Where the record of the compression begins."""
    return bytes(content).index(b"laszip encoded") - 2 + 54


FORGED = {
    "points": lambda c: struct.pack_into("<Q", c, 247, 10**12),
    "records": lambda c: struct.pack_into("<I", c, 100, 2**31),
    "records behind": lambda c: struct.pack_into("<QI", c, 235, 400, 2**31),
    "data": lambda c: struct.pack_into("<I", c, 96, 2**31),
    "items": lambda c: struct.pack_into("<H", c, compression(c) + 32, 60_000),
    "size of an item": lambda c: struct.pack_into("<H", c, compression(c) + 36, 60_000),
    "chunk": lambda c: struct.pack_into("<I", c, compression(c) + 12, 2**31),
    "layer": lambda c: struct.pack_into("<I", c, struct.unpack_from("<I", c, 96)[0] + 8 + 30 + 4 + 28, 2**32 - 256),
    "table": lambda c: struct.pack_into("<q", c, struct.unpack_from("<I", c, 96)[0], 2**60),
    "chunks": lambda c: struct.pack_into(
        "<I", c, struct.unpack_from("<q", c, struct.unpack_from("<I", c, 96)[0])[0] + 4, 3_710_846_819
    ),
}


@pytest.mark.parametrize("what", FORGED)
def test_forged_laz_is_refused(tmp_path, rng, what):
    path = tmp_path / "cloud.laz"
    content = written(path, rng)
    check_las(path)
    FORGED[what](content)
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"cloud\.laz") as caught:
        read_points(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("form", [0, 6, 7, 8])
def test_points_on_a_line_in_several_chunks_are_read(tmp_path, form):
    las = laspy.LasData(laspy.LasHeader(point_format=form, version="1.4"))
    las.x = las.y = las.z = np.arange(60_000.0)  # 300 times smaller than their points, and two chunks
    las.write(str(tmp_path / "line.laz"))
    assert read_points(tmp_path / "line.laz").shape == (60_000, 3)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_what_was_written_is_read(tmp_path, rng, suffix):
    path = tmp_path / f"cloud{suffix}"
    written(path, rng)
    assert read_points(path).shape == (3000, 3)


@pytest.mark.parametrize("length", [0, 3, 100, 226, 300])
def test_cut_off_file_is_refused(tmp_path, rng, length):
    path = tmp_path / "cloud.las"
    content = written(path, rng)
    path.write_bytes(content[:length])
    with pytest.raises(FormatError):
        read_points(path)
