"""The six verdicts on a run: smeared map, degenerate drift, IMU start, false loops, mounting and clock, drift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.checks.records import Finding, Number, worst
from heliograph.checks.surfaces import Thickness
from heliograph.config import CheckConfig
from heliograph.data import GraphAccount, StartAccount

__all__ = ["RUN_CHECKS", "VERDICT_WORDS", "RunEvidence", "check_run"]

VERDICT_WORDS: Mapping[str, str] = {"ok": "PASS", "warn": "WARN", "fail": "FAIL", "unknown": "CANNOT TELL"}
"""How verdicts are written for people."""

_MIN_WAY = 20.0  # path below which a gap per 100 m says nothing [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunEvidence:
    """What the six verdicts rest on, once a run has ended.

    Parameters
    ----------
    walls : tuple of Thickness
        The windows of the run.
    range_sigma : float
        Range noise across planes as the scans showed it at the end [m]; NaN where nothing matched.
    inertial : tuple of Finding
        The IMU's checks inside the run, merged over its windows.
    has_lidar, has_imu : bool
        What the run rests on.
    blind : str
        The costliest stretch along which one direction was not seen, in words; empty for none.
    blind_growth, blind_share : float
        What it added to the position's one-sigma [m]; share of the scans that were degenerate.
    start : StartAccount or None
    gyro_bias, accel_bias : (2, 3) float64
        As the run had them at a fifth of its way and at its end; NaN where it is too short.
    level_sigma : float
        One-sigma of the tilt [rad]; NaN where nothing tells which way is up.
    graph : GraphAccount or None
    distance, gap : float
        Length of the path, and distance between its ends [m].
    config : CheckConfig
    """

    walls: tuple[Thickness, ...] = ()
    range_sigma: float = float("nan")
    inertial: tuple[Finding, ...] = ()
    has_lidar: bool = True
    has_imu: bool = True
    blind: str = ""
    blind_growth: float = 0.0
    blind_share: float = 0.0
    start: StartAccount | None = None
    gyro_bias: Array = field(default_factory=lambda: np.full((2, 3), np.nan))
    accel_bias: Array = field(default_factory=lambda: np.full((2, 3), np.nan))
    level_sigma: float = float("nan")
    graph: GraphAccount | None = None
    distance: float = 0.0
    gap: float = 0.0
    config: CheckConfig = field(default_factory=CheckConfig)

    def __post_init__(self) -> None:
        freeze(self)


def check_run(evidence: RunEvidence) -> tuple[Finding, ...]:
    """Return the six verdicts, one each, in the order of `RUN_CHECKS`."""
    return tuple(check(evidence) for check in RUN_CHECKS)


def check_smear(evidence: RunEvidence) -> Finding:
    """Judge how thick the cleanest walls came out, and whether turning or distance makes them thicker."""
    code, title, picture = "smeared-map", "smeared map", "map.png"
    if not evidence.walls:
        why = "no window of the run shows enough pieces of wall or floor" if evidence.has_lidar else "there is no LiDAR"
        return Finding(code=code, title=title, verdict="unknown", evidence=why)
    thick = np.array([wall.whole for wall in evidence.walls])
    middle = evidence.walls[int(np.argsort(thick, kind="stable")[(len(thick) - 1) // 2])]
    config = evidence.config
    numbers = (
        Number(name="thickness", value=middle.whole, unit="m", limit=config.warn_thickness),
        Number(name="calm", value=_or_none(middle.calm), unit="m"),
        Number(name="turning", value=_or_none(middle.turning), unit="m"),
        Number(name="near", value=_or_none(middle.near), unit="m"),
        Number(name="far", value=_or_none(middle.far), unit="m"),
    )
    turns = _worse(middle.turning, middle.calm)
    text = f"clean walls are {1e3 * middle.whole:.0f} mm thick (1 sigma, {middle.cubes} pieces)"
    if np.isfinite(middle.turning) and np.isfinite(middle.calm):
        text += f", {1e3 * middle.calm:.0f} mm seen calmly and {1e3 * middle.turning:.0f} mm in turns"
    verdict = (
        "fail" if middle.whole > config.max_thickness else "warn" if middle.whole > config.warn_thickness else "ok"
    )
    if verdict == "ok":
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers, picture=picture)
    remedy = (
        "they smear in turns: check the time of the points, the clock offset and the mounting (`heliograph calibrate`)"
        if turns
        else "look at the map: people, leaves and glass thicken it, and so do a wrong range scale and a loose mount"
    )
    return Finding(
        code=code, title=title, verdict=verdict, evidence=text, remedy=remedy, numbers=numbers, picture=picture
    )


def check_degeneracy(evidence: RunEvidence) -> Finding:
    """Judge what stretches cost along which one direction was not seen."""
    code, title, picture = "degenerate-drift", "degenerate drift", "report.html#what-the-scans-could-see"
    if not evidence.has_lidar:
        return Finding(code=code, title=title, verdict="unknown", evidence="there is no LiDAR", picture=picture)
    budget = evidence.config.max_blind_growth
    numbers = (
        Number(name="growth", value=evidence.blind_growth, unit="m", limit=budget),
        Number(name="degenerate scans", value=evidence.blind_share),
    )
    if not evidence.blind:
        text = "every scan saw all directions" if not evidence.blind_share else "no stretch was blind"
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers, picture=picture)
    if evidence.blind_growth <= budget:
        return Finding(
            code=code, title=title, verdict="ok", numbers=numbers, picture=picture,
            evidence=f"blind stretches cost up to {evidence.blind_growth:.3f} m of position (1 sigma)",
        )  # fmt: skip
    remedy = "distrust the length along it; walk such a place with the sensor tilted, or come back and close a loop"
    wheels = _held_by_wheels(evidence.graph)
    if wheels:
        remedy = "trajectory and map follow the wheels: hold one known length along it against them"
    return Finding(
        code=code,
        title=title,
        verdict="fail",
        evidence=evidence.blind + wheels,
        remedy=remedy,
        numbers=numbers,
        picture=picture,
    )


def _held_by_wheels(graph: GraphAccount | None) -> str:
    """Return what wheels or legs add where the odometry was blind; "" where most of their steps were left out.

    It takes nothing from the verdict: what is said of the odometry has what its wheels held in it already.
    """
    wheels = None if graph is None else graph.wheels
    if wheels is None or not np.isfinite(wheels.scale) or 2 * wheels.slips > wheels.steps:
        return ""
    return (
        f"; {wheels.steps - wheels.slips} of {wheels.steps} steps of the graph are held "
        f"by wheels, scale {wheels.scale:.4f} +- {wheels.scale_sigma:.4f}"
    )


def check_start(evidence: RunEvidence) -> Finding:
    """Judge how the IMU began and where its biases went: rest, settling, which way is up."""
    code, title, picture = "imu-start", "IMU start", "report.html#uncertainty"
    start = evidence.start
    if start is None or not evidence.has_imu or start.kind == "no-imu":
        return Finding(code=code, title=title, verdict="unknown", evidence="there is no IMU", picture=picture)
    config = evidence.config
    gyro, accel = (float(np.linalg.norm(bias[1])) for bias in (evidence.gyro_bias, evidence.accel_bias))
    moved = float(np.linalg.norm(evidence.accel_bias[1] - evidence.accel_bias[0]))
    tilt = float(np.degrees(evidence.level_sigma))
    numbers = (
        Number(name="accelerometer bias", value=_or_none(accel), unit="m/s^2", limit=config.warn_accel_bias),
        Number(name="gyroscope bias", value=_or_none(gyro), unit="rad/s", limit=config.warn_gyro_bias),
        Number(name="accelerometer bias moved by", value=_or_none(moved), unit="m/s^2"),
        Number(name="level sigma", value=_or_none(tilt), unit="deg", limit=config.warn_level_deg),
    )
    began = "at rest" if start.kind == "static" else "in motion"
    text = f"began {began} ({start.verdict}); biases ended at {accel:.2g} m/s^2 and {gyro:.2g} rad/s"
    text += f", level known to {tilt:.2g} deg" if np.isfinite(tilt) else ""
    common = Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers, picture=picture)
    if gyro > config.max_gyro_bias or accel > config.max_accel_bias:
        remedy = "no IMU has such a bias: check its units, axes and mounting with `heliograph check`"
        return replace(common, verdict="fail", remedy=remedy)
    if gyro > config.warn_gyro_bias or accel > config.warn_accel_bias:
        remedy = "calibrate the IMU (six positions at rest), and begin with 2 s at rest"
        return replace(common, verdict="warn", remedy=remedy)
    if start.verdict == "poor" or tilt > config.warn_level_deg:
        remedy = "begin with 2 s at rest, and turn about the vertical axis on the way"
        return replace(common, verdict="warn", remedy=remedy)
    return common


def check_loops(evidence: RunEvidence) -> Finding:
    """Judge the closed loops by what the solution then made of them."""
    code, title, picture = "false-loop", "false loops", "loops.csv"
    graph = evidence.graph
    if graph is None or not (graph.accepted or graph.revoked):
        text = "there is no graph" if graph is None else f"no loop was closed ({graph.candidates} candidates)"
        return Finding(code=code, title=title, verdict="unknown", evidence=text)
    share = graph.revoked / (graph.accepted + graph.revoked)
    numbers = (Number(name="taken back", value=share, limit=evidence.config.max_revoked_share),)
    text = f"{graph.accepted} loops stand, {graph.revoked} were taken back; they moved the path by {graph.moved:.3f} m"
    if share <= evidence.config.max_revoked_share:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers, picture=picture)
    return Finding(
        code=code, title=title, verdict="warn", evidence=text, numbers=numbers, picture=picture,
        remedy="places look alike here: look at them with `heliograph loops RUN`, or run with --no-loops and compare",
    )  # fmt: skip


def check_mounting_and_clock(evidence: RunEvidence) -> Finding:
    """Pass on what matters most of the IMU's checks: axes, units, mounting, clock."""
    code, title, picture = "mounting-clock", "mounting and clock", "report.html#sensors"
    found = worst(evidence.inertial)
    if found is None or not evidence.has_imu:
        why = "the run is too short to tell" if evidence.has_imu else "there is no IMU to compare with"
        return Finding(code=code, title=title, verdict="unknown", evidence=why, picture=picture)
    told = [finding for finding in evidence.inertial if finding.verdict != "unknown"]
    if found.verdict in ("ok", "unknown"):
        shown = [finding for finding in told if finding.code in ("clock-offset", "gyro-axes", "mounting", "lever-arm")]
        verdict = "ok" if shown else "unknown"
        text = "; ".join(f.evidence for f in shown) or "the motion is too even to tell axes, mounting or clock"
        numbers = tuple(number for finding in shown for number in finding.numbers[:1])
        return Finding(code=code, title=title, verdict=verdict, evidence=text, numbers=numbers, picture=picture)
    return Finding(
        code=code,
        title=title,
        verdict=found.verdict,
        evidence=f"{found.title}: {found.evidence}",
        remedy=found.remedy,
        numbers=found.numbers,
        picture=picture,
    )


def check_drift(evidence: RunEvidence) -> Finding:
    """Judge what the path had drifted by where it came back, per 100 m."""
    code, title, picture = "drift", "drift", "report.html#trajectory"
    graph, way = evidence.graph, evidence.distance
    if graph is None or not graph.accepted or way < _MIN_WAY:
        text = f"no loop stands that would tell the drift ({evidence.gap:.2f} m between the path's ends)"
        text = text if way >= _MIN_WAY else f"{way:.1f} m of path are too short to tell"
        return Finding(code=code, title=title, verdict="unknown", evidence=text, picture=picture)
    drift = 100.0 * graph.moved / way
    numbers = (
        Number(name="per 100 m", value=drift, unit="m", limit=evidence.config.warn_drift),
        Number(name="start-end gap", value=evidence.gap, unit="m"),
    )
    text = f"loops show {graph.moved:.3f} m of drift over {way:.0f} m, {drift:.2f} m per 100 m; it is taken out"
    if drift <= evidence.config.warn_drift:
        return Finding(code=code, title=title, verdict="ok", evidence=text, numbers=numbers, picture=picture)
    return Finding(
        code=code, title=title, verdict="warn", evidence=text, numbers=numbers, picture=picture,
        remedy="see mounting, clock and IMU start above; come back more often, drift between two loops is shared out",
    )  # fmt: skip


RUN_CHECKS = (
    check_smear,
    check_degeneracy,
    check_start,
    check_loops,
    check_mounting_and_clock,
    check_drift,
)
"""One function a verdict, in the order of the lesson's chapter on failures."""


def _worse(turning: float, calm: float) -> bool:
    return bool(turning > 1.3 * calm)


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
