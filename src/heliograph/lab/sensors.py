"""Chapter 0: LiDAR alone smears, the IMU alone drifts, both together follow."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.cloud import voxel_downsample
from heliograph.config import CloudConfig, FilterConfig, ImuConfig, RunConfig
from heliograph.data import ImuBatch, Scan, ScanResult
from heliograph.errors import DataError
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
from heliograph.lab.true_way import TrueWay
from heliograph.lie import se3
from heliograph.metrics import map_sharpness
from heliograph.odometry import Odometry, make_odometry
from heliograph.sim import SCENARIOS, Simulation, simulate

__all__ = ["EXPERIMENT", "SensorsRun", "light", "shaken_room", "wall_thickness"]

MODES = {"LiDAR": frozenset({"lidar"}), "IMU": frozenset({"imu"}), "fused": frozenset({"lidar", "imu"})}
SWEEP = 0.1  # [s]
_SEED, _SECONDS = 1, 16.0
_POINTS = 600  # to match a scan with: a step of three odometries answers within a tenth of a second
_SLICE = 0.25  # half the height of the slice that is drawn [m]
_CELL = 0.03  # [m]
_REST_SCANS = 12
_UNMATCHED = 2  # scans after one another, after which a way is followed no further
_START_WINDOW = 0.6  # [s]
_MAX_CELLS, _MAX_MEASURED = 30_000, 5_000  # of a map; of it, where walls are measured
# A scan that smears does not converge: it is content with a step that the picture does not show.
_ITERATIONS, _STILL_TURN, _STILL_SHIFT = 1, 2e-3, 5e-3  # once the kernel has narrowed; [rad], [m]


def shaken_room(speed: float, shake: float, *, beams: int = 16, columns: int = 96) -> Simulation:
    """Return the walk round the room's table that the first two experiments are about.

    Parameters
    ----------
    speed : float
        [m/s].
    shake : float
        Amplitude of the swaying of the hand: 1 is 25 deg in yaw and 10 deg in roll and pitch, 2.4 times a second.
    beams, columns : int
        Rays of a sweep.
    """
    scenario = SCENARIOS["room"].thinned(beams=beams, columns=columns, duration=_SECONDS)
    return simulate(
        scenario.varied(
            walk={"speed": speed, "rest": 1.2, "ramp": 1.0},
            gait={"frequency": 2.4, "yaw_deg": 25.0 * shake, "pitch_deg": 10.0 * shake, "roll_deg": 10.0 * shake},
        ),
        seed=_SEED,
    )


def light(*, deskew: str = "imu") -> RunConfig:
    """Return the settings of an odometry that answers while somebody waits: as `heliograph run`, with fewer points.

    Parameters
    ----------
    deskew : str
        ``"imu"`` or ``"off"``.
    """
    return RunConfig(
        cloud=CloudConfig(target_points=_POINTS, deskew=deskew),
        imu=ImuConfig(start_window=_START_WINDOW),
        filter=FilterConfig(
            max_iterations=_ITERATIONS, tolerance_rotation=_STILL_TURN, tolerance_position=_STILL_SHIFT
        ),
    )


def wall_thickness(points: NDArray[np.float32]) -> float:
    """Return the thickness of a growing map's walls [mm], from a few thousand of its points (N, 3) [m]."""
    return 1e3 * map_sharpness(points[:: -(-len(points) // _MAX_MEASURED)], 0.2).thickness


@dataclass(slots=True)
class Track:
    """One choice of sensors: its odometry, where it has been, and its map.

    Whose scans match nothing any more is followed no further: what comes then is a search for its place, which is
    another chapter's and takes seconds.
    """

    odometry: Odometry
    stamps_ns: list[int] = field(default_factory=list)
    T_odom_imu: list[NDArray[np.float64]] = field(default_factory=list)
    points: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.float32))
    unmatched: int = 0

    @property
    def astray(self) -> bool:
        """Whether the last scans matched nothing."""
        return self.unmatched >= _UNMATCHED

    def add(self, results: list[ScanResult], *, matches: bool = True) -> None:
        """Take the results of a message; ``matches``, whether its scans are matched at all."""
        for result in results:
            lost = matches and result.status in ("predicted", "lost")
            self.unmatched = self.unmatched + 1 if lost else 0
            self.stamps_ns.append(result.end_ns)
            self.T_odom_imu.append(result.T_odom_imu)
            placed = se3.act(result.T_odom_imu, result.points_imu.astype(np.float64)).astype(np.float32)
            self.points = np.concatenate([self.points, placed[voxel_downsample(placed, _CELL)]])
            if len(self.points) > _MAX_CELLS:  # a quarter less, so that it is not done after every scan
                self.points = self.points[voxel_downsample(self.points, _CELL)][-3 * _MAX_CELLS // 4 :]


class SensorsRun(ExperimentRun):
    """The same walk followed with each choice of sensors.

    Parameters
    ----------
    settings : Settings
        ``speed`` [m/s], ``shake`` (1 is 25 deg of yaw), ``lidar_deskew``: "off" or "constant velocity".
    """

    def __init__(self, settings: Settings) -> None:
        self.simulation = shaken_room(float(settings["speed"]), float(settings["shake"]))
        off = settings["lidar_deskew"] == "off"
        configs = dict.fromkeys(MODES, light()) | {"LiDAR": light(deskew="off" if off else "imu")}
        self.tracks = {
            name: Track(make_odometry(configs[name], self.simulation.rig, sensors, threads=1))
            for name, sensors in MODES.items()
        }
        self._messages, self._truth = iter(self.simulation), TrueWay(self.simulation)
        self.done = False
        self.error = ""
        while not all(track.stamps_ns for track in self.tracks.values()) and not self.done:
            self.step("step", settings)  # the rest before the walk, which the odometries wait for

    def step(self, action: str, settings: Settings) -> None:  # noqa: ARG002 - the protocol's
        """Take the messages of the next scan."""
        for message in self._messages:
            for name, track in self.tracks.items():
                if isinstance(message, Scan) or (isinstance(message, ImuBatch) and "imu" in MODES[name]):
                    self._follow(track, message, matches="lidar" in MODES[name])
            if isinstance(message, Scan):
                return
        if not self.done:
            self.done = True
            for track in self.tracks.values():
                if not track.astray:
                    track.add(track.odometry.finish())

    def _follow(self, track: Track, message: Scan | ImuBatch, *, matches: bool) -> None:
        try:
            if not track.astray:
                track.add(track.odometry.add(message), matches=matches)
        except DataError as error:
            self.error = str(error)

    def errors(self, name: str) -> NDArray[np.float64]:
        """Return distances from the truth, (N,), the first pose put on the true one [m]."""
        track = self.tracks[name]
        if not track.stamps_ns:
            return np.zeros(0)
        T = np.stack(track.T_odom_imu)
        T_truth = self._truth.poses(track.stamps_ns)
        shift = (T_truth[0] @ np.linalg.inv(T[0]) @ T)[:, :3, 3] - T_truth[:, :3, 3]
        return np.asarray(np.linalg.norm(shift, axis=1))

    def view(self, settings: Settings) -> ExperimentView:
        """Return the chosen map, and the distances from the truth of all three."""
        shown = str(settings["mode"])
        track, errors = self.tracks[shown], {name: self.errors(name) for name in MODES}
        seconds = {name: 1e-9 * (np.array(self.tracks[name].stamps_ns, dtype=np.int64) - self._first) for name in MODES}
        smear = float(settings["speed"]) * SWEEP
        readings = [
            Reading(name="smear", label="way during one sweep", value=smear, digits=3, unit="m"),
            *(
                Reading(name=f"error_{name}", label=f"{name}: off by", value=float(e[-1]) if len(e) else 0.0, unit="m")
                for name, e in errors.items()
            ),
        ]
        if len(track.points) > 200:
            thickness = wall_thickness(track.points)
            readings.append(
                Reading(name="thickness", label="thickness of the walls", value=thickness, digits=1, unit="mm")
            )
        charts = (
            Chart(
                name="map", title=f"{shown}: map and path, from above", x="x [m]", y="y [m]", equal=True,
                traces=self._map(track),
            ),
            Chart(
                name="errors", title="Distance from the truth", x="time [s]", y="[m]", log=True,
                x_range=(0.0, _SECONDS),
                traces=tuple(
                    ChartTrace(name=name, kind="line", x=seconds[name], y=np.maximum(e, 1e-4), color=color)
                    for color, (name, e) in enumerate(errors.items(), 1)
                ),
            ),
        )  # fmt: skip
        return ExperimentView(message=self._message(errors), readings=tuple(readings), charts=charts, done=self.done)

    @property
    def _first(self) -> int:
        return min((track.stamps_ns[0] for track in self.tracks.values() if track.stamps_ns), default=0)

    def _map(self, track: Track) -> tuple[ChartTrace, ...]:
        if not track.stamps_ns:
            return ()
        at_height = track.points[np.abs(track.points[:, 2]) < _SLICE]
        path = np.stack(track.T_odom_imu)[:, :2, 3]
        return (
            ChartTrace(name="wall", kind="points", x=at_height[:, 0], y=at_height[:, 1], color=0),
            ChartTrace(name="path", kind="line", x=path[:, 0], y=path[:, 1], color=2),
        )

    def _message(self, errors: dict[str, NDArray[np.float64]]) -> str:
        if self.error:
            return self.error
        if not any(len(e) > _REST_SCANS for e in errors.values()):
            return "A second of rest is over, from which the IMU knows its biases. Step or Auto: the walk begins."
        worst = max((name for name in errors if len(errors[name])), key=lambda name: errors[name][-1])
        end = "The walk is over. " if self.done else ""
        astray = ", ".join(name for name, track in self.tracks.items() if track.astray)
        if astray:
            end += f"{astray} matches nothing any more and is followed no further. "
        return f"{end}Farthest from the truth now: {worst}, by {errors[worst][-1]:.2f} m."


CODE = """
from heliograph.lab.sensors import light, shaken_room
from heliograph.odometry import make_odometry

walk = shaken_room(speed=1.5, shake=1.0)
odometry = make_odometry(light(), walk.rig, frozenset({"lidar", "imu"}), threads=1)
results = [result for message in walk for result in odometry.add(message)] + odometry.finish()
print(len(results), "scans, the last at", results[-1].T_odom_imu[:3, 3])
""".strip()

EXPERIMENT = Experiment(
    name="sensors",
    title="LiDAR, IMU, or both",
    chapter="0: why two sensors",
    question="A LiDAR takes a tenth of a second for a turn. Raise speed and shaking: alone it smears its own map, the "
    "IMU alone drifts away with the square of time, both together do neither.",
    controls=(
        Control(name="mode", label="Map of", default="fused", choices=tuple(MODES), live=True),
        Control(name="speed", label="Speed", default=1.5, low=0.2, high=3.0, step=0.1, unit="m/s"),
        Control(name="shake", label="Shaking", default=1.0, low=0.0, high=1.5, step=0.1),
        Control(
            name="lidar_deskew", label="LiDAR alone takes out its motion", default="off",
            choices=("off", "constant velocity"),
        ),
    ),
    begin=SensorsRun,
    command="heliograph run drive.bag --sensors lidar   # then imu, then lidar,imu",
    code=CODE,
    worked=lambda: (
        WorkedNumber(text="way during one sweep: 1.5 m/s x 0.1 s", value=1.5 * SWEEP, digits=2),
    ),
)  # fmt: skip
