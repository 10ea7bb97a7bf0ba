"""Chapter 6: in a tunnel one eigenvalue collapses; the LiDAR alone stands still, the IMU carries it through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
from heliograph.lab.sensors import light
from heliograph.odometry import make_odometry
from heliograph.registration import InformationAnalysis, analyse_information
from heliograph.sim import SCENARIOS, Simulation, simulate

__all__ = ["EXPERIMENT", "TunnelRun", "eigenvalues_of_the_lesson", "smooth_tunnel"]

_SEED, _SECONDS = 1, 24.0
_AXES = ("weakest", "middle", "strongest")
THRESHOLD = 100.0
_MAX_RATIO = 1e5  # of eigenvalues: what noise leaves of the weakest says no more


def smooth_tunnel(reach: float, speed: float) -> Simulation:
    """Return a drive through a tunnel of 300 m whose walls are smooth but for its first and last 15 m.

    Parameters
    ----------
    reach : float
        How far the LiDAR sees [m].
    speed : float
        [m/s].
    """
    scenario = SCENARIOS["long-tunnel"].thinned(beams=16, columns=120, duration=_SECONDS)
    return simulate(
        scenario.varied(walk={"speed": speed, "rest": 1.2, "ramp": 2.0}, lidar={"max_range": reach}), seed=_SEED
    )


class TunnelRun(ExperimentRun):
    """A drive into a tunnel, with or without the IMU.

    Parameters
    ----------
    settings : Settings
        ``imu``, ``reach`` [m], ``speed`` [m/s].
    """

    def __init__(self, settings: Settings) -> None:
        self.simulation = smooth_tunnel(float(settings["reach"]), float(settings["speed"]))
        self._aided = bool(settings["imu"])
        sensors = frozenset({"lidar", "imu"} if self._aided else {"lidar"})
        self.config = light()
        self._odometry = make_odometry(self.config, self.simulation.rig, sensors, threads=1)
        self._messages = iter(self.simulation)
        self.results: list[ScanResult] = []
        self.done = False
        self.step("step", settings)  # the rest before the drive, which the odometry waits for

    def step(self, action: str, settings: Settings) -> None:  # noqa: ARG002 - the protocol's
        """Take the messages of the next two scans."""
        before = len(self.results)
        while len(self.results) < before + 2 and not self.done:
            message = next(self._messages, None)
            if message is None:
                self.done = True
                self.results += self._odometry.finish()
            elif isinstance(message, Scan) or (self._aided and isinstance(message, ImuBatch)):
                self.results += self._odometry.add(message)

    def along(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the way along the tunnel since the first scan: estimated, true, and its one-sigma, (N,) each [m]."""
        T = np.stack([r.T_odom_imu for r in self.results])
        T_truth = self.simulation.truth.pose(np.array([r.end_ns for r in self.results]))
        T = T_truth[0] @ np.linalg.inv(T[0]) @ T  # the tunnel runs along the world's x
        axis = np.array(
            [r.T_odom_imu[:3, :3] @ s[:3, :3].T @ [1.0, 0.0, 0.0] for r, s in zip(self.results, T, strict=True)]
        )
        variance = np.array([a @ r.pose_covariance[3:, 3:] @ a for a, r in zip(axis, self.results, strict=True)])
        return T[:, 0, 3] - T[0, 0, 3], T_truth[:, 0, 3] - T_truth[0, 0, 3], np.sqrt(np.maximum(variance, 0.0))

    def view(self, settings: Settings) -> ExperimentView:  # noqa: ARG002 - the protocol's
        """Return the eigenvalues of the last scan and over time, and how far along the tunnel one is said to be."""
        last, (estimated, true, sigma) = self.results[-1], self.along()
        seconds = np.array([r.end_ns - self.results[0].end_ns for r in self.results]) * 1e-9
        shares = np.stack([r.eigenvalues_translation for r in self.results])
        now = shares[-1]
        ratio = float(now[2] / now[0]) if now[0] > 0.0 else float("inf")
        shown: float | str = ratio if ratio < _MAX_RATIO else "over 100 000"
        error = float(estimated[-1] - true[-1])
        blind = sum(r.status == "degenerate" for r in self.results)
        readings = (
            Reading(name="weakest", label="weakest eigenvalue (share)", value=float(now[0]), digits=4),
            Reading(name="ratio", label="strongest : weakest", value=shown, digits=0),
            Reading(name="status", label="this scan is", value=last.status),
            Reading(name="blind", label="degenerate so far", value=float(blind), digits=0),
            Reading(name="error", label="off along the tunnel", value=error, unit="m"),
            Reading(name="sigma", label="its sigma says", value=float(sigma[-1]), unit="m"),
        )
        charts = (
            Chart(
                name="bars", title="Eigenvalues of this scan's information", x="", y="share", log=True,
                traces=(ChartTrace(name="", kind="bars", x=_AXES, y=np.maximum(now, 1e-5), color=1),),
                y_range=(1e-5, 3.0), lines=((1.0 / 3.0, "even in all directions"),),
            ),
            Chart(
                name="shares", title="The same over time", x="time [s]", y="share", log=True, x_range=(0.0, _SECONDS),
                y_range=(1e-5, 1.0),
                traces=tuple(
                    ChartTrace(name=name, kind="line", x=seconds, y=np.maximum(shares[:, i], 1e-5), color=color)
                    for i, (name, color) in enumerate(zip(_AXES, (2, 4, 1), strict=True))
                ),
            ),
            Chart(
                name="along", title="Way along the tunnel", x="time [s]", y="[m]", x_range=(0.0, _SECONDS),
                traces=(
                    ChartTrace(name="truth", kind="line", x=seconds, y=true, color=0, dashed=True),
                    ChartTrace(name="estimate", kind="line", x=seconds, y=estimated, color=1),
                ),
            ),
        )  # fmt: skip
        return ExperimentView(message=self._message(last, error), readings=readings, charts=charts, done=self.done)

    def _message(self, last: ScanResult, error: float) -> str:
        helped = "the IMU carries it" if self._aided else "without an IMU nothing does"
        if last.status == "degenerate":
            x, y, z = last.weak_direction
            return f"Blind along ({x:+.2f}, {y:+.2f}, {z:+.2f}); {helped}. Off by {error:+.2f} m along the tunnel."
        return f"This scan is {last.status}; off by {error:+.2f} m along the tunnel."


def eigenvalues_of_the_lesson() -> InformationAnalysis:
    """Return the analysis of the lesson's corridor: 240 across it, 3 along it, 100 as the least that counts as seen."""
    return analyse_information(np.diag([240.0, 240.0, 240.0, 3.0, 240.0, 240.0]), threshold=THRESHOLD)


CODE = """
from heliograph.lab.sensors import light
from heliograph.lab.tunnel import smooth_tunnel
from heliograph.odometry import make_odometry

drive = smooth_tunnel(reach=20.0, speed=4.0)
odometry = make_odometry(light(), drive.rig, frozenset({"lidar", "imu"}), threads=1)
for message in drive:
    for result in odometry.add(message):
        print(result.status, result.eigenvalues_translation, result.weak_direction)
""".strip()

EXPERIMENT = Experiment(
    name="tunnel",
    title="The tunnel",
    chapter="6: degeneracy",
    question="Smooth walls say nothing of how far along them one is: one eigenvalue collapses. Drive with the IMU and "
    "without, and with a LiDAR that reaches farther.",
    controls=(
        Control(name="imu", label="IMU aid", default=True),
        Control(name="reach", label="The LiDAR sees", default=20.0, low=10.0, high=90.0, step=5.0, unit="m"),
        Control(name="speed", label="Speed", default=4.0, low=1.0, high=6.0, step=0.5, unit="m/s"),
    ),
    begin=TunnelRun,
    command="heliograph simulate long-tunnel -o tunnel   # then: heliograph run tunnel",
    code=CODE,
    worked=lambda: (
        WorkedNumber(
            text="240 / 3, with 100 as the least that counts as seen: ratio",
            value=eigenvalues_of_the_lesson().condition_translation, digits=0,
        ),
    ),
)  # fmt: skip
