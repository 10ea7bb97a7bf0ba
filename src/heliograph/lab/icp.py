"""Chapter 2: registration step by step, with each residual."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from heliograph.config import AlignConfig
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
    WorkedNumber,
)
from heliograph.lie import se3, so3
from heliograph.registration import AlignResult, PreparedCloud, align, prepare_cloud
from heliograph.registration.align_levels import level_matches
from heliograph.sim.sensors import LidarModel, measure_ranges
from heliograph.sim.world import Primitive, SimulatedWorld, Surface, box, cylinder, rectangle

__all__ = ["EXPERIMENT", "ONE_STEP", "IcpRun", "residuals_of_the_lesson", "two_scans"]

METHODS = ("point-to-plane", "point-to-point", "point-to-edge", "gicp")
SCENES = ("room", "corridor")
_GATE = 1.5  # largest distance of partners [m]
_VOXEL = 0.3
_STILL = 1e-4  # a step that is none [m, rad]

ONE_STEP = AlignConfig(
    voxel=_VOXEL, levels=1, iterations=1, gate=_GATE / _VOXEL, kernel=2.0 * _GATE / _VOXEL, min_cosine=0.0,
    min_overlap=0.0, min_matches=3, remap=False, one_sided=False,
)  # fmt: skip
"""Settings of a single step of Gauss-Newton on all points at once, without the way from coarse to fine."""

T_TRUE = se3.exp([0.0, 0.0, 0.15, 0.4, 0.15, 0.0])


def _world(scene: str) -> SimulatedWorld:
    return SimulatedWorld([*_walls(scene)])


def _walls(scene: str) -> Iterator[Primitive]:
    plain = Surface(reflectivity=0.5, contrast=0.2, period=1.0)
    faces_x, faces_y = so3.from_rpy(np.pi / 2, 0.0, np.pi / 2), so3.from_rpy(np.pi / 2, 0.0, 0.0)
    half = 30.0 if scene == "corridor" else 5.0
    yield rectangle((0.0, 0.0, -1.2), (2.0 * half, 6.0), np.eye(3), plain)
    for y in (-3.0, 3.0):
        yield rectangle((0.0, y, 0.3), (2.0 * half, 3.0), faces_y, plain)
    if scene == "corridor":
        return
    for x in (-half, half):
        yield rectangle((x, 0.0, 0.3), (6.0, 3.0), faces_x, plain)
    yield box((2.6, 1.5, -0.4), (1.2, 0.8, 1.6), so3.from_rpy(0.0, 0.0, 0.4), plain)
    for x, y in (
        (-3.2, 1.6),
        (-1.4, -1.9),
        (1.2, -1.4),
        (3.6, -1.1),
        (-3.9, -1.2),
        (0.6, 2.1),
        (-0.8, 1.3),
        (4.2, 2.3),
    ):
        yield cylinder((x, y, 0.3), 0.03, 3.0, None, plain)


def two_scans(scene: str = "room", seed: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return two scans of a room with poles, or of a corridor, from places 0.4 m and 8.6 deg apart: (N, 3), (M, 3).

    Parameters
    ----------
    scene : str
        ``"room"`` or ``"corridor"``.
    seed : int
        Seed of the ranges' noise.
    """
    model = LidarModel(
        beams=32, columns=540, elevation_deg=(-25.0, 25.0), min_range=0.3, max_range=12.0, range_noise=0.01
    )
    world, rng, clouds = _world(scene), np.random.default_rng(seed), []
    directions = model.directions()
    for T in (np.eye(4), T_TRUE):
        exact = world.cast(directions, np.tile(T, (model.columns, 1, 1)), min_range=0.3, max_range=model.max_range)
        ranges = measure_ranges(exact, model, rng)
        clouds.append(np.ascontiguousarray((directions * ranges[..., None])[ranges > 0.0], dtype=np.float32))
    return clouds[0], clouds[1]


class IcpWay:
    """One residual's way from the start, a step of Gauss-Newton at a time.

    Parameters
    ----------
    target, source : PreparedCloud
    method : str
        The residual.
    T : (4, 4) float64
        T_target_source to start from.
    """

    def __init__(self, target: PreparedCloud, source: PreparedCloud, method: str, T: NDArray[np.float64]) -> None:
        self.target, self.source, self.method, self.T = target, source, method, T
        self.history: list[tuple[float, float]] = []
        self.result: AlignResult | None = None
        self.moved = np.inf
        self._note()

    @property
    def ended(self) -> bool:
        """Whether the last step moved less than a tenth of a millimetre and of a milliradian."""
        return bool(self.moved < _STILL)

    def step(self) -> None:
        """Find partners and take one step."""
        if self.ended:
            return
        self.result = align(self.target, self.source, method=self.method, start=self.T, config=ONE_STEP)
        if self.result.T_target_source is None:
            self.moved = 0.0
            return
        d = se3.log(se3.inverse(self.T) @ self.result.T_target_source)
        self.T, self.moved = np.ascontiguousarray(self.result.T_target_source), float(np.abs(d).max())
        self._note()

    def matches(self) -> NDArray[np.float64]:
        """Return the partners at the present pose: point 3, normal 3 (source frame), residual, ..., elements 2."""
        kernel = ONE_STEP.kernel * ONE_STEP.voxel
        return level_matches(self.target, self.source, self.T, self.method, 0, kernel, ONE_STEP, 1)

    def off(self) -> tuple[float, float]:
        """Return how far the present pose is from the true one: metres, degrees."""
        d = se3.log(se3.inverse(T_TRUE) @ self.T)
        return float(np.linalg.norm(d[3:])), float(np.degrees(np.linalg.norm(d[:3])))

    def _note(self) -> None:
        rows = self.matches()
        self.history.append((float(np.sqrt(np.mean(rows[:, 6] ** 2))) if len(rows) else np.nan, self.off()[0]))


class IcpRun(ExperimentRun):
    """Two scans, a start beside the truth, and one step of Gauss-Newton at a time, with every residual side by side.

    Parameters
    ----------
    settings : Settings
        ``method`` that is looked at, ``scene``, and the start's offset ``dx``, ``dy`` [m] and ``turn`` [deg].
    """

    def __init__(self, settings: Settings) -> None:
        target, source = two_scans(str(settings["scene"]))
        self.target, self.source = prepare_cloud(target, ONE_STEP), prepare_cloud(source, ONE_STEP)
        offset = [0.0, 0.0, np.radians(float(settings["turn"])), float(settings["dx"]), float(settings["dy"]), 0.0]
        start = np.ascontiguousarray(T_TRUE @ se3.exp(offset))
        self.ways = {method: IcpWay(self.target, self.source, method, start) for method in METHODS}

    def step(self, action: str, settings: Settings) -> None:  # noqa: ARG002 - the protocol's
        """Find partners and take one step, with each residual."""
        for way in self.ways.values():
            way.step()

    def view(self, settings: Settings) -> ExperimentView:
        """Return both scans at the chosen way's pose, its partners, and how the offset of every way fell."""
        way = self.ways[str(settings["method"])]
        rows, (metres, degrees) = way.matches(), way.off()
        rms = np.array([row for row, _ in way.history])
        readings = [
            Reading(name="steps", label="steps taken", value=float(len(way.history) - 1), digits=0),
            Reading(name="rms", label="rms of the residuals", value=float(rms[-1]), digits=4, unit="m"),
            Reading(name="matches", label="partners", value=float(len(rows)), digits=0),
            Reading(name="off", label="off the truth by", value=metres, digits=4, unit="m"),
            Reading(name="turned", label="and by", value=degrees, digits=3, unit="deg"),
        ]
        blind = (
            ", ".join(str(d) for d in way.result.observability.blind) if way.result and way.result.observability else ""
        )
        if blind:
            readings.append(Reading(name="blind", label="not observable", value=blind))
        charts = (
            Chart(
                name="scans", title=f"Two scans and their partners: {way.method}", x="x [m]", y="y [m]", equal=True,
                traces=_scan_traces(way, rows),
            ),
            Chart(
                name="offsets", title="Off the truth, with each residual", x="step", y="[m]", log=True,
                traces=tuple(
                    ChartTrace(
                        name=name, kind="line", x=np.arange(len(other.history)), color=color,
                        y=np.maximum([off for _, off in other.history], 1e-5), dashed=other is not way,
                    )
                    for color, (name, other) in enumerate(self.ways.items(), 1)
                ),
            ),
            Chart(
                name="fall", title=f"Residuals: {way.method}", x="step", y="rms [m]", log=True,
                traces=(ChartTrace(name="", kind="line", x=np.arange(len(rms)), y=np.maximum(rms, 1e-5), color=2),),
            ),
        )  # fmt: skip
        return ExperimentView(
            message=_message(way, blind),
            readings=tuple(readings),
            charts=charts,
            done=all(other.ended for other in self.ways.values()),
        )


def _message(way: IcpWay, blind: str) -> str:
    if way.result is None:
        return "The second scan lies where the start puts it. Step: find partners, and take one step."
    if way.result.T_target_source is None:
        return f"No step: {way.result.reason}."
    kept = f" It cannot see {blind}: there the start's error stays." if blind else ""
    if way.ended:
        return f"{way.method} has converged: its last step moved less than a tenth of a millimetre.{kept}"
    return f"Step {len(way.history) - 1} moved by up to {1e3 * way.moved:.1f} mm or mrad.{kept}"


def _scan_traces(way: IcpWay, rows: NDArray[np.float64]) -> tuple[ChartTrace, ...]:
    target, source = _elements(way.target), se3.act(way.T, _elements(way.source).astype(np.float64))
    parts = [
        ChartTrace(name="first scan", kind="points", x=target[:, 0], y=target[:, 1], color=0),
        ChartTrace(name="second scan", kind="points", x=source[:, 0], y=source[:, 1], color=1),
    ]
    if len(rows):
        p = se3.act(way.T, rows[:, :3])
        q = target[rows[:, -1].astype(np.int64)]
        pairs = np.stack([p[:, :2], q[:, :2], np.full((len(p), 2), np.nan)], axis=1)[:: max(len(p) // 400, 1)]
        flat = pairs.reshape(-1, 2)
        parts.insert(0, ChartTrace(name="partners", kind="segments", x=flat[:, 0], y=flat[:, 1], color=3))
    return tuple(parts)


def _elements(cloud: PreparedCloud) -> NDArray[np.float32]:
    """Return one point a cube, (K, 3), as the registration uses it."""
    return np.asarray(cloud.native.elements(0)[0])


def residuals_of_the_lesson() -> tuple[float, float]:
    """Return what p' = (2.1, 0.3) has of the wall x = 2, to the plane and to its point q = (2, 0) [m]."""
    p, q, n = np.array([2.1, 0.3]), np.array([2.0, 0.0]), np.array([1.0, 0.0])
    return float((p - q) @ n), float(np.linalg.norm(p - q))


CODE = """
import numpy as np
from heliograph.lab.icp import ONE_STEP, T_TRUE, two_scans
from heliograph.lie import se3
from heliograph.registration import align

target, source = two_scans("room")
T = T_TRUE @ se3.exp([0.0, 0.0, np.radians(6.0), 0.4, -0.2, 0.0])  # the start: 0.4 m, -0.2 m and 6 deg off
for _ in range(6):
    T = align(target, source, method="point-to-plane", start=T, config=ONE_STEP).T_target_source
    print(np.linalg.norm(se3.log(se3.inverse(T_TRUE) @ T)[3:]))  # metres off the truth
""".strip()


def _worked() -> tuple[WorkedNumber, ...]:
    plane, point = residuals_of_the_lesson()
    return (
        WorkedNumber(text="p' = (2.1, 0.3) to the plane x = 2", value=plane, digits=1),
        WorkedNumber(text="the same to its nearest point q = (2, 0)", value=point, digits=3),
    )


EXPERIMENT = Experiment(
    name="icp",
    title="ICP, step by step",
    chapter="2: scan matching",
    question="Two scans of one place. Step: partners are found and the second scan moves. Each residual goes its own "
    "way beside the others: point to plane is there in five or six steps, point to point creeps, edges alone are few. "
    "In the corridor, nothing says how far along it one is.",
    controls=(
        Control(name="method", label="Residual", default="point-to-plane", choices=METHODS, live=True),
        Control(name="scene", label="Scene", default="room", choices=SCENES),
        Control(name="dx", label="Start off along x", default=0.4, low=-1.0, high=1.0, step=0.1, unit="m"),
        Control(name="dy", label="Start off along y", default=-0.2, low=-1.0, high=1.0, step=0.1, unit="m"),
        Control(name="turn", label="Start turned by", default=6.0, low=-20.0, high=20.0, step=1.0, unit="deg"),
    ),
    actions=(Action(name="step", label="Step", hint="find partners and take one step"),),
    begin=IcpRun,
    command="heliograph align target.pcd source.pcd --method point-to-plane",
    code=CODE,
    worked=_worked,
)
