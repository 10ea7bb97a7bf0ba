"""Chapter 1: a sweep as it was measured and as it was meant, and the map that grows of each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.cloud import deskew, voxel_downsample
from heliograph.data import ImuBatch, Scan, ScanResult
from heliograph.lab.experiment import (
    Chart,
    ChartTrace,
    Control,
    Experiment,
    ExperimentRun,
    ExperimentView,
    Reading,
    Settings,
    WorkedNumber,
)
from heliograph.lab.sensors import SWEEP, light, shaken_room, wall_thickness
from heliograph.lie import se3
from heliograph.odometry import make_odometry

__all__ = ["EXPERIMENT", "SweepRun", "point_of_the_lesson"]

_SLICE, _CELL, _MAX_CELLS = 0.25, 0.03, 30_000  # [m], [m]
_REST_SCANS = 14
_CLOUDS = ("raw", "corrected")


def point_of_the_lesson(speed: float = 1.5, age: float = 0.08, distance: float = 3.0) -> float:
    """Return where a point straight ahead lies in the frame of the sweep's start [m].

    Parameters
    ----------
    speed : float
        Speed of the sensor, straight ahead [m/s].
    age : float
        When the point was measured, after the start of the sweep [s].
    distance : float
        What was measured then [m].
    """
    end_ns = round(1e9 * SWEEP)
    moved = deskew(
        np.array([[distance, 0.0, 0.0]], np.float32), np.array([round(1e9 * age)], np.int32), stamp_ns=0,
        path_stamps_ns=np.array([0, end_ns]), R_odom_body=np.stack([np.eye(3)] * 2),
        p_odom=np.array([[0.0, 0.0, 0.0], [speed * SWEEP, 0.0, 0.0]]), T_body_lidar=np.eye(4), reference=0,
    )  # fmt: skip
    return float(moved[0, 0])


def _thinned(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return one point a cube, and of them at most three quarters of the limit, the latest: not after every scan."""
    return points[voxel_downsample(points, _CELL)][-3 * _MAX_CELLS // 4 :]


class SweepRun(ExperimentRun):
    """A walk followed with both sensors; each sweep is kept raw and corrected.

    Parameters
    ----------
    settings : Settings
        ``speed`` [m/s] and ``shake``.
    """

    def __init__(self, settings: Settings) -> None:
        self.simulation = shaken_room(float(settings["speed"]), float(settings["shake"]), beams=16, columns=180)
        self._odometry = make_odometry(light(), self.simulation.rig, frozenset({"lidar", "imu"}), threads=1)
        self._messages, self._scans = iter(self.simulation), dict[int, Scan]()
        self.maps = {name: np.zeros((0, 3), dtype=np.float32) for name in _CLOUDS}
        self.sweep = {name: np.zeros((0, 3), dtype=np.float32) for name in _CLOUDS}
        self.path: list[NDArray[np.float64]] = []
        self.moved = self.misplaced = 0.0
        self.done = False
        self.step("step", settings)  # the rest before the walk, which the odometry waits for

    def step(self, action: str, settings: Settings) -> None:  # noqa: ARG002 - the protocol's
        """Follow one more sweep."""
        before = len(self.path)
        while len(self.path) == before and not self.done:
            message = next(self._messages, None)
            results: list[ScanResult] = []
            if message is None:
                self.done = True
                results = self._odometry.finish()
            elif isinstance(message, (Scan, ImuBatch)):
                if isinstance(message, Scan):
                    self._scans[message.stamp_ns] = message
                results = self._odometry.add(message)
            for result in results:
                self._take(result)

    def _take(self, result: ScanResult) -> None:
        scan = self._scans.pop(result.stamp_ns)
        raw = se3.act(result.T_imu_lidar, scan.points.astype(np.float64))
        for name, cloud in (("raw", raw), ("corrected", result.points_imu.astype(np.float64))):
            placed = se3.act(result.T_odom_imu, cloud).astype(np.float32)
            self.sweep[name] = placed
            grown = np.concatenate([self.maps[name], placed[voxel_downsample(placed, _CELL)]])
            self.maps[name] = grown if len(grown) < _MAX_CELLS else _thinned(grown)
        if len(self.sweep["raw"]) == len(self.sweep["corrected"]):
            shift = np.linalg.norm(self.sweep["raw"] - self.sweep["corrected"], axis=1)
            self.misplaced = float(shift.max(initial=0.0))
        self.moved = float(np.linalg.norm(result.v_odom)) * SWEEP
        self.path.append(result.T_odom_imu[:2, 3].copy())

    def view(self, settings: Settings) -> ExperimentView:
        """Return the last sweep both ways, and the map of the chosen way."""
        chosen = "corrected" if settings["deskew"] else "raw"
        readings = [
            Reading(name="smear", label="way during one sweep", value=float(settings["speed"]) * SWEEP, unit="m"),
            Reading(name="moved", label="as the filter sees it now", value=self.moved, unit="m"),
            Reading(name="misplaced", label="farthest point moved by", value=self.misplaced, unit="m"),
            Reading(
                name="lesson", label="3.00 m ahead after 0.08 s is at", unit="m",
                value=point_of_the_lesson(float(settings["speed"])),
            ),
        ]  # fmt: skip
        for name in _CLOUDS:
            if len(self.maps[name]) > 200:
                thick = wall_thickness(self.maps[name])
                readings.append(
                    Reading(name=f"thickness_{name}", label=f"walls, {name}", value=thick, digits=1, unit="mm")
                )
        at_height = {name: cloud[np.abs(cloud[:, 2]) < _SLICE] for name, cloud in self.sweep.items()}
        grown = self.maps[chosen][np.abs(self.maps[chosen][:, 2]) < _SLICE]
        path = np.array(self.path).reshape(-1, 2)
        sweep = Chart(
            name="sweep", title="One sweep, from above", x="x [m]", y="y [m]", equal=True,
            traces=tuple(
                ChartTrace(name=name, kind="points", x=cloud[:, 0], y=cloud[:, 1], color=color)
                for (name, cloud), color in zip(at_height.items(), (3, 1), strict=True)
            ),
        )  # fmt: skip
        growing = Chart(
            name="map", title=f"The map of {chosen} sweeps", x="x [m]", y="y [m]", equal=True,
            traces=(
                ChartTrace(name="wall", kind="points", x=grown[:, 0], y=grown[:, 1], color=0),
                ChartTrace(name="path", kind="line", x=path[:, 0], y=path[:, 1], color=2),
            ),
        )  # fmt: skip
        return ExperimentView(
            message=self._message(), readings=tuple(readings), charts=(sweep, growing), done=self.done
        )

    def _message(self) -> str:
        if len(self.path) < _REST_SCANS:
            return "At rest, raw and corrected are one. Step or Auto: each step is one turn of the LiDAR, 0.1 s."
        return f"Sweep {len(self.path)}: correcting it moved its farthest point by {self.misplaced:.3f} m."


CODE = """
import numpy as np
from heliograph.cloud import deskew

point, age = np.array([[3.0, 0.0, 0.0]], np.float32), np.array([80_000_000], np.int32)  # 3 m ahead, after 80 ms
way = np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0]])  # 1.5 m/s for a tenth of a second
print(deskew(point, age, stamp_ns=0, path_stamps_ns=np.array([0, 100_000_000]), p_odom=way,
             R_odom_body=np.stack([np.eye(3)] * 2), T_body_lidar=np.eye(4), reference=0))  # 3.12
""".strip()

EXPERIMENT = Experiment(
    name="deskew",
    title="De-skewing a sweep",
    chapter="1: motion distortion",
    question="Every point of a sweep was measured at its own time, from its own place. Switch the correction off and "
    "watch the walls thicken; raise the speed and watch the two copies of one sweep part.",
    controls=(
        Control(name="deskew", label="De-skewing", default=True, live=True),
        Control(name="speed", label="Speed", default=1.5, low=0.2, high=3.0, step=0.1, unit="m/s"),
        Control(name="shake", label="Shaking", default=1.0, low=0.0, high=1.5, step=0.1),
    ),
    begin=SweepRun,
    command="heliograph run drive.bag --set cloud.deskew=off",
    code=CODE,
    worked=lambda: (
        WorkedNumber(text="1.5 m/s x 0.08 s", value=point_of_the_lesson() - 3.0, digits=2),
        WorkedNumber(text="3.00 m + 0.12 m, from the sweep's start", value=point_of_the_lesson(), digits=2),
        WorkedNumber(text="at 2 m/s the last point is off by", value=point_of_the_lesson(2.0, 0.1) - 3.0, digits=2),
    ),
)  # fmt: skip
