"""Poses in a file, whatever of the two formats they are in, with their stamps."""

from __future__ import annotations

from pathlib import Path

from heliograph.data import Trajectory
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.stamps import STAMP_FILES
from heliograph.io.files.tum import read_kitti, read_tum

__all__ = ["is_pose_file", "read_poses"]

_KITTI_WIDTH = 12


def is_pose_file(name: str) -> bool:
    """Whether the name of an odometry is a file of poses: a path, or a file that stands here."""
    path = Path(name)
    return path.is_file() or "/" in name or path.suffix.lower() in (".tum", ".txt", ".csv", ".kitti")


def read_poses(path: Path | str, *, stamped: bool = False, frame: str = "map", body: str = "imu") -> Trajectory:
    """Read a TUM or KITTI file, told apart by the numbers in a row.

    Parameters
    ----------
    path : Path or str
        The file.
    stamped : bool
        Whether the rows must have times: KITTI's are those of ``times.txt`` beside the file, one a row.
    frame, body : str
        Names of the trajectory's frames.

    Raises
    ------
    FormatError
        The file cannot be read or holds something else; with ``stamped``, rows without times.
    """
    path = Path(path)
    try:
        with plain_file(path, TABLE).open(encoding="utf-8", errors="replace") as file:
            rows = (line.partition("#")[0].replace(",", " ").split() for line in file)
            width = next((len(row) for row in rows if row), 0)
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror}); give a TUM or KITTI trajectory file") from error
    if width != _KITTI_WIDTH:
        return read_tum(path, frame=frame, body=body)
    if not stamped:
        return read_kitti(path, frame=frame, body=body)
    times = next((found for name in STAMP_FILES if (found := path.parent / name).is_file()), None)
    if times is None:
        raise FormatError(
            path, f"holds KITTI rows, which have no times; put {STAMP_FILES[0]} with one stamp a row beside it"
        )
    return read_kitti(path, times, frame=frame, body=body)
