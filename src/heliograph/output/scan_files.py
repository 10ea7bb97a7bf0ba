"""De-skewed scans as files, for other tools: a cloud each, and where the odometry had the sensor."""

from __future__ import annotations

from pathlib import Path

from heliograph.atomic import check_output_directory
from heliograph.data import ScanResult
from heliograph.io.files.clouds import write_cloud
from heliograph.output.sink import Sink
from heliograph.snapshots import Snapshot

__all__ = ["ScanFiles"]


class ScanFiles(Sink):
    """Writes ``000000.ply`` and so on: a scan's points, de-skewed to its end, imu frame [m], with intensity.

    The poses at the scans' ends are in the run's ``scans.csv`` (``end_ns``), by the number in a file's name.

    Parameters
    ----------
    folder : Path
        Made if absent; must be empty.

    Raises
    ------
    OutputError
        It is not empty, or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = check_output_directory(folder, overwrite=False)

    def add(self, result: ScanResult) -> None:
        """Write one scan; one without a point leaves no file."""
        if len(result.points_imu):
            write_cloud(self._folder / f"{result.index:06d}.ply", result.points_imu, intensity=result.intensity)

    def snapshot(self) -> Snapshot:
        """Return nothing: files stay."""
        return {}

    def restore(self, snapshot: Snapshot) -> None:  # noqa: ARG002 - the protocol's
        """Go on behind the files that are there."""
        return
