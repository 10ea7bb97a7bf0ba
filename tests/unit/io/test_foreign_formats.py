"""Files that are no recordings are named, with the way out."""

import pytest

from heliograph.errors import FormatError
from heliograph.io.files.foreign import foreign_format
from heliograph.io.registry import open_raw_source

FILES = {
    "log.ulg": (b"ULog\x01\x12\x35\x01", "ULog", "ROS bag or MCAP"),
    "a.lvx": (b"livox_tech", "Livox", "livox_ros_driver2"),
    "a.lvx2": (b"livox_tech\0\0\0\0\0\0\x02", "lvx2", "livox_ros_driver2"),
    "scan.e57": (b"ASTM-E57", "E57", "heliograph align"),
    "cloud.laz": (b"LASF", "LAS", "heliograph align"),
    "x.rrd": (b"RRF2", "Rerun", "name the bag"),
}


@pytest.mark.parametrize("name", FILES)
def test_foreign_file_is_named_with_the_way_out(tmp_path, name):
    head, kind, way_out = FILES[name]
    path = tmp_path / name
    path.write_bytes(head + bytes(400))
    with pytest.raises(FormatError, match=f"not a recording but .*{kind}.*{way_out}"):
        open_raw_source([path])
    renamed = path.rename(tmp_path / "data.bin")
    assert kind.replace("lvx2", "Livox") in foreign_format(renamed)


def test_folder_of_las_files_is_named(tmp_path):
    for k in range(3):
        (tmp_path / f"{k}.las").write_bytes(b"LASF" + bytes(400))
    with pytest.raises(FormatError, match=r"a folder of 3 \.las files: .* convert them to PCD or PLY"):
        open_raw_source([tmp_path])


def test_unknown_file_stays_unknown(tmp_path):
    path = tmp_path / "notes.md"
    path.write_text("# notes")
    assert foreign_format(path) == foreign_format(tmp_path) == ""
