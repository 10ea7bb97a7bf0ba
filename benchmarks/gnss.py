"""Surveys with a receiver's good and bad spells: where the map comes to lie on Earth, and what was believed.

``python -m benchmarks.gnss FIRST LAST [NAME...]``: ways without clouds (`tests.gnss_worlds`), whose odometry drifts
step by step as it says; a row a way, and the table.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from tests.gnss_worlds import Survey, absolute_error, georeferenced, survey

from heliograph.graph import Between, Covariance, FactorGraph, Marginals, Symbol
from heliograph.lie import SE3, se3
from heliograph.survey.placed_run import position_in_frame

__all__ = ["SURVEYS", "georeference_section", "measure_gnss"]

X, E = Symbol("X"), Symbol("E")
SURVEYS: dict[str, dict[str, Any]] = {
    "survey-campus": {},
    "survey-campus-rtk": {},
    "city-loop": {},
    "city-loop-rtk": {},
    "still": {"gnss": {"rate": 10.0, "spells": ()}, "duration": 5.0},
    "lying": {"gnss": {"reported_scale": 0.01}},
}
_PLACE = {"still": "survey-campus", "lying": "survey-campus"}
_HEAD = """## Surveys with satellite fixes

Simulated ways (campus 1.1 km, city 3 km), the odometry's noise drawn step by step (3 mm, 0.02 deg a metre), fixes
twice a second with 60 s of outage, 20 s of reflection at 15 m, two jumps, 8 s of freezing; `lying` claims a hundredth
of its noise, `still` stands for 5 s. `python -m benchmarks.gnss 201 220`, seeds not used before. Bars: 0.3 m with fixes
of 1 m, 0.03 m with RTK, heading 0.1 deg, no fix of a bad spell above 0.1.

"""
_EVERY = 50  # keyframes between those whose NEES is looked at


def measure_gnss(seeds: Iterable[int], names: Iterable[str] = ()) -> Iterator[dict[str, Any]]:
    """Yield a row a way: errors on Earth, heading, the heaviest fix of a bad spell, and NEES of the position."""
    for seed in seeds:
        for name in list(names) or list(SURVEYS):
            world = survey(_PLACE.get(name, name), seed, **SURVEYS[name])
            began = time.process_time()
            fixes, smoother = georeferenced(world)
            seconds = time.process_time() - began
            account = fixes.account(smoother, smoother.estimate(X(np.arange(len(world.chain)))).matrix)
            row = {"kind": "gnss", "survey": name, "seed": seed, "keyframes": len(world.chain), "cpu_s": seconds}
            if account.georeference is None:
                yield {**row, "aligned": False, "reason": account.reason, "used": account.counts.get("used", 0)}
                continue
            rmse, heading, account, off = absolute_error(world, fixes, smoother)
            yield {
                **row,
                "aligned": True,
                "rmse_m": rmse,
                "heading_deg": heading,
                "mean_heading_deg": _common_turn(world, account, smoother),
                "heaviest_bad": _heaviest(world, account),
                "bad_used": int(sum(weight > 0.1 for weight in _bad_weights(world, account))),
                "bad": len(_bad_weights(world, account)),
                "used": account.counts.get("used", 0),
                "nees": _nees(world, fixes, smoother, off),
            }


def _bad_weights(world: Survey, account: Any) -> list[float]:  # noqa: ANN401
    rows = {fix.stamp_ns: fix.weight for fix in account.fixes}
    log: Any = world.log
    return [rows[int(stamp)] for stamp in log.stamps_ns[log.bad & log.valid]]


def _heaviest(world: Survey, account: Any) -> float:  # noqa: ANN401
    return max(_bad_weights(world, account), default=0.0)


def _common_turn(world: Survey, account: Any, smoother: Any) -> float:  # noqa: ANN401
    """Return by how much the whole map is turned on Earth [deg]: what aligning its way with the truth would turn."""
    T = account.georeference.T_enu_map @ smoother.estimate(X(np.arange(len(world.chain)))).matrix
    p, q = T[:, :2, 3] - T[:, :2, 3].mean(axis=0), world.T_world_keyframes[:, :2, 3]
    q = q - q.mean(axis=0)
    return float(np.degrees(abs(np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum()))))


def _nees(world: Survey, fixes: Any, smoother: Any, off: np.ndarray) -> float:  # noqa: ANN401
    """Return the mean NEES (3 degrees of freedom) of positions on Earth, of a keyframe in fifty."""
    graph, values = FactorGraph(), smoother.estimate()
    T, keys = world.chain.T_odom_imu, X(np.arange(len(world.chain)))
    graph.fix(keys[0])
    steps = np.ascontiguousarray(se3.inverse(T[:-1]) @ T[1:])
    graph.add(Between(keys[:-1], keys[1:], SE3(steps), Covariance(world.chain.step_covariances[1:])))
    for group in fixes.factors().groups():
        graph.adopt(group)
    marginals, T_enu_map = Marginals(graph, values), np.linalg.inv(values.at(E(0)).matrix)
    found = []
    for k in range(_EVERY, len(world.chain), _EVERY):
        P, J, _ = position_in_frame(marginals, int(X(k)), values.at(X(k)).matrix[:4, :4], T_enu_map)
        found.append(float(off[k] @ np.linalg.solve(J @ P @ J.T, off[k])))
    return float(np.mean(found))


def georeference_section(rows: Sequence[dict[str, Any]], table: Callable[[list[str], list[list[Any]]], str]) -> str:
    """Return the section of a set of rows."""
    head = [
        "survey", "runs", "RMSE, median / worst m", "map's heading, median / worst deg",
        "heading of keyframes, median deg", "heaviest fix of a bad spell", "NEES of position (3)", "not aligned",
    ]  # fmt: skip
    body: list[list[Any]] = []
    for name in dict.fromkeys(row["survey"] for row in rows):
        some = [row for row in rows if row["survey"] == name]
        well = [row for row in some if row["aligned"]]
        cells = [name, len(some), *["-"] * 5, len(some) - len(well)]
        if well:
            keys = ("rmse_m", "mean_heading_deg", "heading_deg")
            rmse, turn, heading = (np.array([row[key] for row in well]) for key in keys)
            cells[2:7] = [
                f"{np.median(rmse):.3f} / {rmse.max():.3f}",
                f"{np.median(turn):.3f} / {turn.max():.3f}",
                f"{np.median(heading):.3f}",
                f"{max(row['heaviest_bad'] for row in well):.2f}",
                f"{np.mean([row['nees'] for row in well]):.2f}",
            ]
        body.append(cells)
    return _HEAD + table(head, body)


def main(arguments: Sequence[str]) -> None:
    """Print a row a way, and the table."""
    first, last, *names = arguments
    rows = []
    for row in measure_gnss(range(int(first), int(last) + 1), names):
        rows.append(row)
        print(row, flush=True)
    from benchmarks.table import _table

    print(georeference_section(rows, _table))


if __name__ == "__main__":
    main(sys.argv[1:])
