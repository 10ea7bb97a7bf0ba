"""Whether the graph's sigmas are true: keyframe poses in units of their covariance, before and after loops.

Each recording is simulated, run through odometry and back-end in process, and its keyframes put into four graphs:
with the IMU's factors and without them, with the loops that were accepted and without. All loops are looked for, also
where they could not tell more than odometry knows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from heliograph.arrays import Array
from heliograph.chi_square import chi_square_quantile
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Keyframe
from heliograph.lie import se3
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, Scenario, simulate
from heliograph.slam import BackEnd, KeyframeStore
from heliograph.slam.loops import Ledger, LedgerEntry
from heliograph.slam.session import SlamSession

__all__ = ["GRAPH_SIGMA_SCENARIOS", "graph_nees", "graph_sigmas_section", "measure_graph_sigmas"]

GRAPH_SIGMA_SCENARIOS: dict[str, Scenario] = {
    "aisle-laps": SCENARIOS["aisle-laps"],
    "tunnel": SCENARIOS["tunnel"].thinned(beams=16, columns=256),
}
_EVERY = 5  # keyframes that are looked at: neighbours say the same
_THREE_SIGMAS = 14.16  # 99.7 % of a chi-square variable of three
_GRAPHS = {"imu": True, "poses": False}


def measure_graph_sigmas(names: Sequence[str], *, seeds: Iterable[int]) -> Iterator[dict[str, Any]]:
    """Yield one row a recording and kind of graph, as it is done."""
    config = RunConfig()
    config = replace(config, slam=replace(config.slam, loop_worth=0.0))
    for seed in seeds:
        for name in names:
            with TemporaryDirectory() as folder:
                yield from _rows(name, seed, Path(folder), config)


def _rows(name: str, seed: int, folder: Path, config: RunConfig) -> Iterator[dict[str, Any]]:
    simulation = simulate(GRAPH_SIGMA_SCENARIOS[name], seed)
    session = SlamSession(folder, config, kept=False)
    odometry = make_odometry(config, simulation.rig, frozenset({"lidar", "imu"}), 1)
    for message in simulation:
        session.observe(message)
        session.add(list(odometry.add(message)))
    session.finish(list(odometry.finish()))
    loops = session.back_end.ledger.accepted()
    session.release()
    keyframes = list(KeyframeStore.open(folder / "keyframes"))
    truth = simulation.truth.pose(np.array([k.stamp_ns for k in keyframes]))
    off = [_distance(entry, truth) for entry in loops]
    for graph, inertial in _GRAPHS.items():
        row = {"scenario": name, "seed": seed, "graph": graph, "keyframes": len(keyframes), "loops": len(loops)}
        row["false"] = sum(metres > 0.5 for metres in off)
        for when, some in (("before", ()), ("after", loops)):
            nees, metres = graph_nees(keyframes, some, truth, config, inertial=inertial)
            whole, place = nees.T
            row |= {
                f"nees_{when}": float(whole.mean()), f"nees_end_{when}": float(whole[-1]),
                f"inside_{when}": float((place < _THREE_SIGMAS).mean()),
                f"rms_{when}_m": float(np.sqrt((metres**2).mean())),
            }  # fmt: skip
        yield row


def graph_nees(
    keyframes: Sequence[Keyframe],
    loops: Sequence[LedgerEntry],
    T_world_imu: Array,
    config: RunConfig,
    *,
    inertial: bool,
    every: int = _EVERY,
) -> tuple[Array, Array]:
    """Solve a graph of keyframes, and return squared errors in units of their covariance, and errors.

    Parameters
    ----------
    keyframes : sequence of Keyframe
    loops : sequence of LedgerEntry
        Those that are in force.
    T_world_imu : (K, 4, 4) float64
        True poses, in a world whose z axis points up.
    config : RunConfig
    inertial : bool
        Whether the IMU's factors are in the graph; without them it holds the odometry's steps.
    every : int
        Every so-many-th keyframe is looked at, the last one among them.

    Returns
    -------
    (N, 2) float64, (N,) float64
        Of the whole pose, six expected, and of the position, three; the position's error [m].
    """
    with TemporaryDirectory() as folder:
        store = KeyframeStore.create(Path(folder))
        for keyframe in keyframes:
            store.append(keyframe if inertial else _without_imu(keyframe))
        ledger = Ledger(config.loops)
        for entry in loops:
            ledger.add_by_hand(entry.evidence)
        back_end = BackEnd.replayed(config, store, ledger)
        T = back_end.T_map_imu
        T_true = _in_map(T_world_imu, T[0], level=inertial)
        chosen = np.arange(len(T) - 1, 0, -every)[::-1]
        d = se3.local(T[chosen], T_true[chosen])
        P = np.stack([back_end.covariance(int(k)) for k in chosen])
        back_end.release()
        store.close()
    whole = np.einsum("ni,ni->n", d, np.linalg.solve(P, d[..., None])[..., 0])
    place = np.einsum("ni,ni->n", d[:, 3:], np.linalg.solve(P[:, 3:, 3:], d[:, 3:, None])[..., 0])
    return np.stack([whole, place], axis=1), np.linalg.norm(d[:, 3:], axis=1)


def _in_map(T_world_imu: Array, T_map_first: Array, *, level: bool) -> Array:
    """Return true poses in a map that begins at the first one: all of it given, or its heading and position only."""
    if not level:
        return np.asarray(T_map_first @ se3.inverse(T_world_imu[0]) @ T_world_imu)
    turn = T_map_first[:3, :3] @ T_world_imu[0, :3, :3].T
    heading = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    c, s = np.cos(heading), np.sin(heading)
    T_map_world = np.eye(4)
    T_map_world[:2, :2] = [[c, -s], [s, c]]
    T_map_world[:3, 3] = T_map_first[:3, 3] - T_map_world[:3, :3] @ T_world_imu[0, :3, 3]
    return np.asarray(T_map_world @ T_world_imu)


def _without_imu(keyframe: Keyframe) -> Keyframe:
    return replace(keyframe, imu=ImuBatch.joined([]), g_odom=np.zeros(3))


def _distance(entry: LedgerEntry, truth: Array) -> float:
    loop = entry.evidence
    d = se3.log(se3.inverse(se3.inverse(truth[loop.match]) @ truth[loop.query]) @ loop.T_match_query)
    return float(np.linalg.norm(d[3:]))


def graph_sigmas_section(rows: Sequence[dict[str, Any]], table: Callable[[list[str], list[list[str]]], str]) -> str:
    """Return the section of BENCHMARKS.md."""
    head = [
        "scenario", "graph", "seeds", "loops", "false", "pose NEES at the end, before", "after", "band",
        "of all keyframes, before", "after", "RMS mm before", "after", "inside 3 sigma % before", "after",
    ]  # fmt: skip
    body = []
    for name, graph in dict.fromkeys((r["scenario"], r["graph"]) for r in rows):
        some = [r for r in rows if (r["scenario"], r["graph"]) == (name, graph)]
        n = len(some)
        low, high = (chi_square_quantile(p, 6 * n) / n for p in (0.025, 0.975))

        def mean(key: str, some: Sequence[dict[str, Any]] = some) -> float:
            return float(np.mean([r[key] for r in some]))

        rms = [1e3 * np.sqrt(np.mean([r[f"rms_{when}_m"] ** 2 for r in some])) for when in ("before", "after")]
        body.append([
            name, graph, str(n), str(sum(r["loops"] for r in some)), str(sum(r["false"] for r in some)),
            f"{mean('nees_end_before'):.2f}", f"{mean('nees_end_after'):.2f}", f"{low:.2f} to {high:.2f}",
            f"{mean('nees_before'):.2f}", f"{mean('nees_after'):.2f}", *(f"{r:.1f}" for r in rms),
            *(f"{100.0 * mean(f'inside_{when}'):.1f}" for when in ("before", "after")),
        ])  # fmt: skip
    return "\n".join([
        "## Sigmas of the graph", "",
        "Simulated recordings through odometry and back-end; every fifth keyframe's pose against the truth in units of "
        "the covariance that the graph gives it, six expected, before and after the loops that it accepted by itself. "
        "`imu`: with the preintegrated factors; `poses`: the odometry's steps alone. Loops are looked for everywhere "
        "(`slam.loop_worth` 0). Band: 95 % of the mean at the end, if the covariance is true.",
        "", table(head, body), "",
    ])  # fmt: skip
