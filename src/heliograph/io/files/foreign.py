"""Formats that people hold on to their LiDAR data in and that are no recording here: named, each with the way out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from heliograph.guard.files import plain_file

__all__ = ["foreign_format"]

_HEAD = 16  # bytes that tell a format

_LIVOX = (
    "a Livox Viewer recording ({ending}); record the sensor through livox_ros_driver2 in its CustomMsg format instead, "
    "or make a bag of this file ({tool}), whose points keep their times"
)
_E57 = (
    "an E57 file: finished clouds of a surveying scanner, not the sweeps of a moving sensor; export its scans as PLY, "
    "PCD or LAS, which `heliograph align` registers to each other"
)
_CLOUD = (
    "one cloud ({kind}), not a recording: a run needs the sweeps as the sensor gave them, in a bag or as a folder of "
    "PCD or PLY files named by their stamps; `heliograph align` registers two clouds to each other"
)
_BY_MAGIC: Sequence[tuple[bytes, str]] = (
    (
        b"ULog\x01\x12\x35",
        "a PX4 flight log (ULog), which holds no LiDAR points; record the LiDAR in a ROS bag or MCAP, and the flight "
        "controller's IMU beside it as sensor_msgs/Imu",
    ),
    (b"livox_tech", ""),
    (b"ASTM-E57", _E57),
    (b"LASF", _CLOUD.format(kind="LAS")),
    (b"RRF", "a recording of the Rerun viewer, which holds what was shown and not what was measured; name the bag"),
)
_BY_ENDING = {
    ".ulg": _BY_MAGIC[0][1],
    ".e57": _E57,
    ".las": _CLOUD.format(kind="LAS"),
    ".laz": _CLOUD.format(kind="LAZ"),
    ".rrd": _BY_MAGIC[4][1],
    ".lvx": _LIVOX.format(ending=".lvx", tool="lvx_to_rosbag of livox_ros_driver"),
    ".lvx2": _LIVOX.format(ending=".lvx2", tool="with a converter to CustomMsg"),
    ".lvx3": _LIVOX.format(ending=".lvx3", tool="with a converter to CustomMsg"),
}
_MAX_LISTED = 200  # files of a folder that are looked at


def foreign_format(path: Path) -> str:
    """Return what a file or a folder of files is, and what to do with it; empty where nobody knows.

    Parameters
    ----------
    path : Path
        That no reader has opened. Its first bytes say more than its name.
    """
    if not path.is_dir():
        return _of_file(path)
    kinds: dict[str, int] = {}
    for k, child in enumerate(sorted(path.iterdir())):
        if k < _MAX_LISTED and child.suffix.lower() in _BY_ENDING and child.is_file():
            kinds[child.suffix.lower()] = kinds.get(child.suffix.lower(), 0) + 1
    if not kinds:
        return ""
    ending = max(kinds, key=lambda name: kinds[name])
    what = _BY_ENDING[ending]
    if ending in (".las", ".laz"):
        what = (
            "LAS clouds, which tell neither when each was taken nor when its points were; convert them to PCD or PLY "
            "files named by their stamps, with a field of time if there is one"
        )
    return f"a folder of {kinds[ending]} {ending} files: {what}"


def _of_file(path: Path) -> str:
    try:
        with plain_file(path).open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        head = b""
    by_magic = next((text for magic, text in _BY_MAGIC if head.startswith(magic)), None)
    by_ending = _BY_ENDING.get(path.suffix.lower(), "")
    if by_magic is None:
        return by_ending
    return by_magic or by_ending or _BY_ENDING[".lvx2" if head[len(b"livox_tech") :].strip(b"\0") else ".lvx"]
