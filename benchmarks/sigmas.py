"""Whether sigmas are true: errors in units of their covariance, over seeds of simulated recordings.

Each recording is simulated, run and held against its exact truth. A row is one recording; the table puts the seeds of a
scenario together: normalised errors (NEES) beside the 95 % band of their mean, sigma beside the RMS error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.config import RunConfig
from heliograph.data import Scan, ScanResult
from heliograph.lie import so3
from heliograph.odometry import make_odometry
from heliograph.output.blind_spans import BlindSpan
from heliograph.output.level import Level
from heliograph.output.summary import Tally, judge
from heliograph.sim import SCENARIOS, Scenario, simulate
from heliograph.sim.trajectory import Gait

__all__ = ["SIGMA_SCENARIOS", "measure_sigmas", "sigmas_section"]

_Rows = list[dict[str, Any]]
_AXIS = np.array([1.0, 0.0, 0.0])  # of the tunnel
_BUDGET = RunConfig().check.max_blind_growth
_INSIDE = 14.16  # 99.7 % of a chi-square variable of three: what three sigmas are of one

_SHAKEN = Gait(frequency=1.1, bounce=0.08, lateral=0.10, roll_deg=18.0, pitch_deg=14.0, yaw_deg=22.0)


def _alone(name: str, rate: float) -> Scenario:
    """Return a scenario for a LiDAR alone, that turns so often a second [Hz]."""
    scenario = replace(SCENARIOS["demo"], gait=_SHAKEN) if name == "shake" else SCENARIOS[name]
    return scenario.thinned(beams=16, columns=256, duration=20.0).varied(lidar={"rate": rate})


SIGMA_SCENARIOS: dict[str, Scenario] = {
    "warehouse": SCENARIOS["warehouse"].thinned(beams=16, columns=256, duration=20.0),
    "demo": SCENARIOS["demo"].thinned(beams=16, columns=256, duration=20.0),
    "room": SCENARIOS["room"].thinned(beams=16, columns=256, duration=20.0),
    "field": SCENARIOS["field"],
    "bare-field": SCENARIOS["bare-field"],
    "level-straight": SCENARIOS["level-straight"].thinned(beams=16),
    "level-turns": SCENARIOS["level-turns"].thinned(beams=16),
    "long-tunnel": SCENARIOS["long-tunnel"],
    "storeys": SCENARIOS["storeys"],
    **{
        f"{name}-lidar-{rate:g}hz": _alone(name, rate)
        for name in ("demo", "room", "warehouse", "shake")
        for rate in (10.0, 3.0)
    },
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """Results of a recording, its true poses in the odom frame, and errors of rotation and position, (N, 6)."""

    results: tuple[ScanResult, ...]
    truth: Array
    T_odom_true: Array
    error: Array
    level: Level
    blind: tuple[BlindSpan, ...]
    sensors: frozenset[str]
    unsteady: int

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of(cls, scenario: Scenario, seed: int, sensors: frozenset[str]) -> _Run:
        """Simulate and run one."""
        simulation = simulate(scenario, seed)
        odometry = make_odometry(RunConfig(), simulation.rig, sensors, 1)
        results, tally = [], Tally()
        messages = simulation if "imu" in sensors else (m for m in simulation if isinstance(m, Scan))
        for result in _results(messages, odometry):
            tally.add(result)
            results.append(result)
        T, truth = _poses(results), simulation.truth.pose(np.array([r.end_ns for r in results]))
        expected = T[0] @ np.linalg.inv(truth[0]) @ truth
        turn = so3.log(np.swapaxes(T[:, :3, :3], 1, 2) @ expected[:, :3, :3])
        error = np.concatenate([turn, expected[:, :3, 3] - T[:, :3, 3]], axis=1)
        said = tally.summary()
        return cls(
            results=tuple(results),
            truth=truth,
            T_odom_true=expected,
            error=error,
            level=said.level,
            blind=tally.blind.all(np.eye(3)),
            sensors=sensors,
            unsteady=tally.unsteady,
        )

    def nees(self, index: int, part: slice = slice(0, 6)) -> float:
        """Return the squared error of a pose in units of its covariance."""
        e, P = self.error[index, part], self.results[index].pose_covariance[part, part]
        return float(e @ np.linalg.solve(P, e))

    def along(self, axis: Array, index: int) -> tuple[float, float]:
        """Return error and sigma of a position along an axis of the odom frame [m]."""
        P = self.results[index].pose_covariance[3:, 3:]
        return float(axis @ self.error[index, 3:]), float(np.sqrt(axis @ P @ axis))


def _results(messages: Iterable[Any], odometry: Any) -> Iterator[ScanResult]:  # noqa: ANN401
    for message in messages:
        yield from odometry.add(message)
    yield from odometry.finish()


def _poses(results: Sequence[ScanResult]) -> Array:
    return np.stack([r.T_odom_imu for r in results])


def measure_sigmas(names: Sequence[str], *, seeds: Iterable[int]) -> Iterator[dict[str, Any]]:
    """Yield one row a recording, as it is done."""
    for seed in seeds:
        for name in names:
            sensors = frozenset({"lidar"} if "-lidar-" in name else {"lidar", "imu"})
            yield _row(name, seed, _Run.of(SIGMA_SCENARIOS[name], seed, sensors))


def _row(name: str, seed: int, run: _Run) -> dict[str, Any]:
    last = len(run.results) - 1
    position = [run.nees(k, slice(3, 6)) for k in range(1, last + 1)]
    statuses = [r.status for r in run.results]
    counts = {s: statuses.count(s) for s in set(statuses)}
    row = {
        "scenario": name,
        "seed": seed,
        "scans": last + 1,
        "status": judge(counts, sensors=run.sensors, unsteady=run.unsteady, blind=run.blind, budget=_BUDGET)[0],
        "blind_share": counts.get("degenerate", 0) / (last + 1),
        "nees": run.nees(last),
        "nees_median": float(np.median([run.nees(k) for k in range(1, last + 1)])),
        "turned_deg": float(np.degrees(np.linalg.norm(run.error[:, :3], axis=1).max())),
        "error_m": float(np.linalg.norm(run.error[last, 3:])),
        "sigma_m": float(np.sqrt(np.trace(run.results[last].pose_covariance[3:, 3:]))),
        "rms_m": float(np.sqrt(np.mean(np.sum(run.error[:, 3:] ** 2, axis=1)))),
        "largest_m": float(np.linalg.norm(run.error[:, 3:], axis=1).max()),
        "inside": float(np.mean(np.array(position) < _INSIDE)),
        "suspect": sum(any(e.code == "match-against-imu" for e in r.events) for r in run.results),
    }
    extra: dict[str, Callable[[_Run], dict[str, float]]] = {
        "long-tunnel": _tunnel,
        "level-straight": _height,
        "level-turns": _height,
    }
    return row | (extra[name](run) if name in extra else {})


def _tunnel(run: _Run) -> dict[str, float]:
    """Return errors along and across the tunnel, where the blind part ends and at the end."""
    axis = run.T_odom_true[0, :3, :3] @ run.truth[0, :3, :3].T @ _AXIS
    side = np.cross([0.0, 0.0, 1.0], axis)
    blind = [r.index for r in run.results if r.status == "degenerate"]
    out, last = blind[-1] if blind else len(run.results) - 1, len(run.results) - 1
    (at_exit, sigma_exit), (at_end, sigma_end) = run.along(axis, out), run.along(axis, last)
    return {
        "exit_m": at_exit,
        "exit_sigma_m": sigma_exit,
        "end_m": at_end,
        "end_sigma_m": sigma_end,
        "lateral_m": float(np.abs(run.error[:, 3:] @ side).max()),
        "rotation_deg": float(np.degrees(np.linalg.norm(run.error[:, :3], axis=1)).max()),
    }


def _height(run: _Run) -> dict[str, float]:
    """Return the error of the height at the end, levelled by the last gravity, and its sigma with the level's part."""
    T, end = np.eye(4), run.results[-1]
    T[:3, :3] = so3.from_two_vectors(end.g_odom, np.array([0.0, 0.0, -1.0]))
    z = T[2, :3] @ (end.T_odom_imu[:3, 3] - run.results[0].T_odom_imu[:3, 3])
    P = end.pose_covariance[3:, 3:] + run.level.of_positions(end.T_odom_imu[None, :3, 3])[0]
    return {
        "height_m": float(z - (run.truth[-1, 2, 3] - run.truth[0, 2, 3])),
        "height_sigma_m": float(np.sqrt(P[2, 2])),
    }


def sigmas_section(rows: _Rows, table: Callable[[Sequence[str], Sequence[Any]], str]) -> str:
    """Return the table: a line a scenario, and what was asked of tunnels and level ways."""
    body = []
    for name in dict.fromkeys(r["scenario"] for r in rows):
        some = [r for r in rows if r["scenario"] == name]
        rms = np.sqrt(np.mean([r["error_m"] ** 2 for r in some]))
        body.append(
            [
                name,
                len(some),
                f"{np.mean([r['nees'] for r in some]):.1f}",
                _band(6, len(some)),
                f"{1e3 * rms:.1f}",
                f"{1e3 * np.median([r['sigma_m'] for r in some]):.1f}",
                f"{100 * np.mean([r['inside'] for r in some]):.1f}",
                sum(r["suspect"] for r in some),
                sum(r["status"] == "ok" for r in some),
                f"{100 * np.mean([r.get('blind_share', np.nan) for r in some]):.0f}",
            ]
        )
    head = [
        "scenario",
        "seeds",
        "pose NEES at the end",
        "band",
        "RMS mm",
        "sigma mm",
        "inside 3 sigma %",
        "suspect scans",
        "ok",
        "blind scans %",
    ]
    text = "## Sigmas\n\nErrors at the end of simulated recordings against what the odometry says of them.\n\n"
    text += table(head, body)
    for key, what in (
        ("exit", "along the tunnel, end of the blind part"),
        ("end", "along the tunnel, end"),
        ("height", "height"),
    ):
        for name in dict.fromkeys(r["scenario"] for r in rows if f"{key}_m" in r):
            e, s = (np.array([r[k] for r in rows if r["scenario"] == name]) for k in (f"{key}_m", f"{key}_sigma_m"))
            text += (
                f"\n{name}, {what}: NEES {np.mean((e / s) ** 2):.2f} (band {_band(1, len(e))}), RMS "
                f"{np.sqrt(np.mean(e**2)):.3f} m, median sigma {np.median(s):.3f} m, inside two sigma "
                f"{100 * np.mean(np.abs(e) < 2.0 * s):.0f} %.\n"
            )
    return text


def _band(dof: int, count: int) -> str:
    """Return the two-sided 95 % interval of the mean of so many chi-square variables."""
    low, high = (chi_square_quantile(p, dof * count) / count for p in (0.025, 0.975))
    return f"{low:.2f} to {high:.2f}"
