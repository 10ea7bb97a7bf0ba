"""A sink of one's own, the path as GeoJSON while the run goes on: python own_sink.py RECORDING OUT.geojson."""

import json
import sys
from pathlib import Path

from heliograph.config import RunConfig
from heliograph.data import ScanResult
from heliograph.io import open_recording
from heliograph.output import RunSummary, Sink
from heliograph.pipeline import run


class GeoJsonPath(Sink):
    """Every metre a point; `heliograph.testing.assert_sink` checks such a class."""

    def __init__(self, path: Path, every: float = 1.0) -> None:
        self.path, self.every, self.points = path, every, []

    def add(self, result: ScanResult) -> None:
        x, y, z = result.T_odom_imu[:3, 3]
        if not self.points or (x - self.points[-1][0]) ** 2 + (y - self.points[-1][1]) ** 2 >= self.every**2:
            self.points.append([float(x), float(y), float(z)])

    def close(self, summary: RunSummary) -> None:
        line = {"type": "LineString", "coordinates": (self.points * 2)[: max(2, len(self.points))]}
        properties = {"status": summary.status, "metres": summary.distance}
        feature = {"type": "Feature", "geometry": line if self.points else None, "properties": properties}
        self.path.write_text(json.dumps(feature))


if __name__ == "__main__":
    with open_recording(sys.argv[1]) as recording:
        summary = run(recording, RunConfig(), sinks=[GeoJsonPath(Path(sys.argv[2]))])
    print(f"{summary.status}: {summary.distance:.2f} m in {sys.argv[2]}")
