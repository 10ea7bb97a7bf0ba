"""Chapter 4: the families of the field on one recording, measured: the filter, features, and a graph behind each."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.cloud import voxel_downsample
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Scan, ScanResult, Trajectory
from heliograph.lab.experiment import (
    Action,
    Chart,
    ChartTrace,
    Control,
    Experiment,
    ExperimentRun,
    ExperimentView,
    Reading,
    Settings,
)
from heliograph.lab.true_way import TrueWay
from heliograph.lie import se3
from heliograph.metrics import absolute_trajectory_error, associate, map_sharpness
from heliograph.odometry import Odometry, make_odometry, odometry_names
from heliograph.sim import SCENARIOS, Simulation, simulate
from heliograph.slam import SlamSession

__all__ = ["ARMS", "EXPERIMENT", "SideBySideRun", "lap"]

ARMS = {"filter": ("filter", False), "loam + graph": ("loam", True), "filter + graph": ("filter", True)}
"""Name -> odometry, and whether a graph stands behind it."""

_SEED, _SECONDS = 1, 40.0
_CELL, _MAX_CELLS = 0.08, 60_000


def lap(speed: float) -> Simulation:
    """Return a lap round a rack of a warehouse, with a LiDAR of 16 beams and a bad IMU; it ends where it began.

    The beams are as dense as features need, `LoamConfig`.
    """
    scenario = SCENARIOS["demo"].thinned(beams=16, columns=360, duration=_SECONDS)
    return simulate(scenario.varied(walk={"speed": speed, "rest": 1.2}, imu={"gyro_noise": 2e-3}), seed=_SEED)


def _thinned(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return one point a cube, and of them at most three quarters of the limit, the latest: not after every scan."""
    return points[voxel_downsample(points, _CELL)][-3 * _MAX_CELLS // 4 :]


@dataclass(slots=True)
class Arm:
    """One system: its odometry, its back-end if it has one, and what came out."""

    odometry: Odometry
    slam: SlamSession | None
    stamps_ns: list[int] = field(default_factory=list)
    T_odom_imu: list[NDArray[np.float64]] = field(default_factory=list)
    points: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.float32))
    seconds: float = 0.0

    def add(self, message: Scan | ImuBatch) -> None:
        """Take a message, on the clock of this thread: what else the machine does is not the system's time."""
        began = time.thread_time()
        if self.slam is not None:
            self.slam.observe(message)
        self._take(self.odometry.add(message), began)

    def finish(self) -> None:
        """Take what was still waiting."""
        self._take(self.odometry.finish(), time.thread_time())

    def _take(self, results: list[ScanResult], began: float) -> None:
        if self.slam is not None:
            self.slam.add(results)
        self.seconds += time.thread_time() - began
        for result in results:
            self.stamps_ns.append(result.end_ns)
            self.T_odom_imu.append(result.T_odom_imu)
            placed = se3.act(result.T_odom_imu, result.points_imu.astype(np.float64)).astype(np.float32)
            grown = np.concatenate([self.points, placed[voxel_downsample(placed, _CELL)]])
            self.points = grown if len(grown) < _MAX_CELLS else _thinned(grown)

    def poses(self) -> NDArray[np.float64]:
        """Return T_map_imu of every scan, (N, 4, 4): the odometry's, moved along with the keyframe before it."""
        T = np.stack(self.T_odom_imu)
        moved = self.slam.moved() if self.slam is not None else None
        if moved is None:
            return T
        which = np.clip(np.searchsorted(moved.stamps_ns, self.stamps_ns, side="right") - 1, 0, None)
        return np.asarray(moved.T_map_imu[which] @ se3.inverse(moved.T_odom_imu[which]) @ T)


class SideBySideRun(ExperimentRun):
    """One recording through every arm at once.

    Parameters
    ----------
    settings : Settings
        ``speed`` [m/s].
    """

    def __init__(self, settings: Settings) -> None:
        self.simulation = lap(float(settings["speed"]))
        self._folders = tempfile.TemporaryDirectory(prefix="heliograph_lab_")
        self.arms: dict[str, Arm] = {}
        for number, (name, (odometry, graph)) in enumerate(ARMS.items()):
            if odometry in odometry_names():
                config = RunConfig(odometry=odometry)
                folder = Path(self._folders.name) / str(number)
                folder.mkdir()
                self.arms[name] = Arm(
                    make_odometry(config, self.simulation.rig, frozenset({"lidar", "imu"}), threads=1),
                    SlamSession(folder, config, kept=False) if graph else None,
                )
        self._messages, self._truth = iter(self.simulation), TrueWay(self.simulation)
        self._scan: list[Scan | ImuBatch] = []
        self._ended, self._waiting = False, list[Arm]()
        self.done = False
        while not all(arm.stamps_ns for arm in self.arms.values()) and not self.done:
            self.step("step", settings)  # the rest before the lap, which the odometries wait for

    def step(self, action: str, settings: Settings) -> None:  # noqa: ARG002 - the protocol's
        """Hand the messages of a scan to the next of the arms; when all have had them, those of the next scan."""
        if self.done:
            return
        if not self._waiting:
            self._scan, self._waiting = self._next_scan(), list(self.arms.values())
        arm = self._waiting.pop(0)
        for message in self._scan:
            arm.add(message)
        if self._ended:
            arm.finish()
            self.done = not self._waiting

    def _next_scan(self) -> list[Scan | ImuBatch]:
        """Return the messages up to the next scan; the last ones, if there is none."""
        taken: list[Scan | ImuBatch] = []
        for message in self._messages:
            if isinstance(message, (Scan, ImuBatch)):
                taken.append(message)
            if isinstance(message, Scan):
                return taken
        self._ended = True
        return taken

    def release(self) -> None:
        """Remove the keyframes."""
        for arm in self.arms.values():
            if arm.slam is not None:
                arm.slam.store.close()
        self._folders.cleanup()

    def error(self, arm: Arm) -> float:
        """Return the absolute trajectory error of an arm so far [m]; NaN before there are enough poses."""
        if len(arm.stamps_ns) < 20:
            return float("nan")
        stamps = np.array(arm.stamps_ns)
        estimate = Trajectory(stamps_ns=stamps, T_frame_body=arm.poses())
        truth = Trajectory(stamps_ns=stamps, T_frame_body=self._truth.poses(arm.stamps_ns))
        return absolute_trajectory_error(associate(estimate, truth), mode="origin").rmse

    def view(self, settings: Settings) -> ExperimentView:  # noqa: ARG002 - the protocol's
        """Return the paths, and the table: error, time, loops, thickness of the map."""
        readings, traces = [], []
        for color, (name, arm) in enumerate(self.arms.items(), 1):
            if not arm.stamps_ns:
                continue
            path = arm.poses()[:, :2, 3]
            traces.append(ChartTrace(name=name, kind="line", x=path[:, 0], y=path[:, 1], color=color))
            ms = 1e3 * arm.seconds / len(arm.stamps_ns)
            readings.append(
                Reading(name=f"ate_{name}", label=f"{name}: ATE", value=1e3 * self.error(arm), digits=1, unit="mm")
            )
            readings.append(Reading(name=f"ms_{name}", label=f"{name}: CPU a scan", value=ms, digits=1, unit="ms"))
            if self.done:
                thick = 1e3 * map_sharpness(arm.points, 0.3).thickness
                readings.append(Reading(name=f"map_{name}", label=f"{name}: walls", value=thick, digits=1, unit="mm"))
            if arm.slam is not None:
                loops = float(arm.slam.back_end.account().accepted)
                readings.append(Reading(name=f"loops_{name}", label=f"{name}: loops", value=loops, digits=0))
        charts = (
            Chart(name="paths", title="Paths, from above", x="x [m]", y="y [m]", equal=True, traces=tuple(traces)),
        )
        return ExperimentView(message=self._message(), readings=tuple(readings), charts=charts, done=self.done)

    def _message(self) -> str:
        missing = [name for name in ARMS if name not in self.arms]
        without = f" Not in this version: {', '.join(missing)}." if missing else ""
        scans = max((len(arm.stamps_ns) for arm in self.arms.values()), default=0)
        if self.done:
            return f"The lap is over: {scans} scans through {len(self.arms)} systems.{without}"
        return f"{scans} scans through {len(self.arms)} systems; press Auto, the lap takes a minute or two.{without}"


CODE = """
from heliograph.config import RunConfig
from heliograph.lab.side_by_side import SideBySideRun

run = SideBySideRun({"speed": 1.5})
while not run.done:
    run.step("step", {})
for name, arm in run.arms.items():
    print(name, 1e3 * run.error(arm), "mm", 1e3 * arm.seconds / len(arm.stamps_ns), "ms a scan")
run.release()
""".strip()

EXPERIMENT = Experiment(
    name="families",
    title="Filter, features, graph",
    chapter="4: two families, one recording",
    question="The same lap, with a poor IMU, through each family of the field: a tightly coupled filter, features with "
    "a graph, and the filter with a graph. Errors, times and maps are measured as you watch.",
    controls=(Control(name="speed", label="Speed", default=1.5, low=0.8, high=3.0, step=0.1, unit="m/s"),),
    actions=(Action(name="step", label="Step", hint="the scan through the next of the systems"),),
    begin=SideBySideRun,
    command="heliograph run drive.bag --no-graph   # then without --no-graph, then --odometry loam",
    code=CODE,
)
