"""Kidnaps in a saved map: a robot wakes up somewhere, walks on, and is told where it is, or not."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import loop_worlds as worlds
from benchmarks.loop_worlds import KeyframeSet, read_keyframes
from heliograph.arrays import Array
from heliograph.config import LoopConfig, RunConfig
from heliograph.data import Scan, ScanResult
from heliograph.lie import se3, so3
from heliograph.localization import Localizer, SavedMap, map_of_keyframes, map_of_points
from heliograph.maps import transformed
from heliograph.odometry.pose_result import pose_result
from heliograph.registration import prepare_cloud
from heliograph.slam.loops import loop_align_config

__all__ = ["SETS", "kidnaps", "scan_results"]

_RIGHT_M, _RIGHT_DEG = 0.5, 5.0
_PARTNER = 0.3
_DRIFT = np.repeat([np.radians(0.05), 0.005], 3)  # of the odometry a keyframe, one-sigma


@dataclass(slots=True)
class Outcomes:
    """What became of the kidnaps of one set."""

    count: int = 0
    wanted: int = 0
    right: int = 0
    false: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    missed: list[tuple[int, str]] = field(default_factory=list)
    wrong: list[tuple[int, float]] = field(default_factory=list)
    lock_s: list[float] = field(default_factory=list)
    left_s: list[float] = field(default_factory=list)
    query_s: list[float] = field(default_factory=list)
    errors_m: list[float] = field(default_factory=list)

    def facts(self) -> dict[str, Any]:
        """Return the counts and quantiles."""
        series = self.lock_s, self.query_s, self.errors_m, self.left_s
        lock, query, error, left = (np.array(values or [np.nan]) for values in series)
        return {
            "kidnaps": self.count,
            "with_partner": self.wanted,
            "right": self.right,
            "false": self.false,
            "ends": dict(self.ends),
            "missed": self.missed[:12],
            "wrong": self.wrong[:8],
            "lock_s": [round(float(q), 2) for q in np.quantile(lock, (0.5, 0.9, 1.0))],
            "query_s": [round(float(q), 3) for q in np.quantile(query, (0.5, 0.99, 1.0))],
            "after_leaving_s": [round(float(q), 2) for q in np.quantile(left, (0.5, 0.9, 1.0))],
            "error_m": [round(float(q), 3) for q in np.quantile(error, (0.5, 0.9, 1.0))],
        }


def scan_results(keyframes: KeyframeSet, first: int, last: int, seconds: float, seed: int) -> list[ScanResult]:
    """Return keyframes as an odometry gives them that woke up at the first one: its frame is turned and moved."""
    rng = np.random.default_rng([11, seed, first])
    T_odom = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, rng.uniform(-np.pi, np.pi)), rng.normal(size=3))
    T_odom = T_odom @ _level(keyframes.T_world_imu[first])
    out: list[ScanResult] = []
    covariance = np.zeros((6, 6))
    for k in range(first, last):
        if k > first:
            step = se3.inverse(keyframes.T_world_imu[k - 1]) @ keyframes.T_world_imu[k]
            T_odom = T_odom @ step @ se3.exp(_DRIFT * rng.standard_normal(6))
            covariance = covariance + np.diag(_DRIFT**2)
        cloud = keyframes.clouds[k]
        stamp = round(1e9 * seconds * (k + 1))
        scan = Scan(
            stamp_ns=stamp, end_ns=stamp, received_ns=stamp, header_stamp_ns=stamp, points=cloud,
            offsets_ns=np.zeros(len(cloud), np.int32),
        )  # fmt: skip
        before = out[-1] if out else None
        out.append(pose_result(scan, k - first, np.ascontiguousarray(T_odom), before=before, covariance=covariance))
    return out


def _level(T: Array) -> Array:
    """Return a pose without its heading and position."""
    R = T[:3, :3]
    return se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, -float(np.arctan2(R[1, 0], R[0, 0]))) @ R, np.zeros(3))


def kidnaps(
    saved: SavedMap, keyframes: KeyframeSet, chosen: Sequence[int], *, seconds: float, patience: float, seed: int = 0,
    config: RunConfig | None = None, partner: Sequence[bool] | None = None,
    inside: Callable[[Array], bool] | None = None,
) -> Outcomes:  # fmt: skip
    """Wake up at each of the chosen keyframes and walk on for some seconds.

    Parameters
    ----------
    saved : SavedMap
    keyframes : KeyframeSet
    chosen : sequence of int
    seconds : float
        Time between keyframes [s].
    patience : float
        After it the kidnap is over [s].
    seed : int
    config : RunConfig, optional
    partner : sequence of bool, optional
        Which of the chosen have a part of the map in view.
    inside : callable, optional
        Pose -> whether it is where places look alike: of who wakes up there, the time to the lock is counted from the
        first keyframe outside.
    """
    out = Outcomes()
    for number, first in enumerate(chosen):
        last = min(len(keyframes), first + 1 + int(patience / seconds))
        localizer = Localizer(saved, config)
        state, locked, left = "not localised", False, -1
        results = scan_results(keyframes, first, last, seconds, seed)
        for k, result in enumerate(results):
            began = time.process_time()
            asked = len(localizer.queries)
            told = localizer.add(result)
            if len(localizer.queries) > asked:
                out.query_s.append(time.process_time() - began)
            state = told.state
            if inside is not None and left < 0 and not inside(keyframes.T_world_imu[first + k]):
                left = k
            if told.T_map_imu is not None:
                d = se3.log(se3.inverse(keyframes.T_world_imu[first + k]) @ told.T_map_imu)
                off, turned = float(np.linalg.norm(d[3:])), float(np.degrees(np.linalg.norm(d[:3])))
                locked = True
                out.lock_s.append(seconds * k)
                if left > 0:
                    out.left_s.append(seconds * (k - left))
                if off <= _RIGHT_M and turned <= _RIGHT_DEG:
                    out.right += 1
                    out.errors_m.append(off)
                else:
                    out.false += 1
                    out.wrong.append((int(first), round(off, 2)))
                break
        out.count += 1
        wanted = partner is None or bool(partner[number])
        out.wanted += wanted
        out.ends[state] += 1
        if not locked and wanted:
            out.missed.append((int(first), state))
    return out


def partners(keyframes: KeyframeSet, cut: int, chosen: Sequence[int], reach: float = 12.0) -> list[bool]:
    """Return which keyframes overlap one of the map's, those before ``cut``, by `_PARTNER` both ways at the truth."""
    config = loop_align_config(LoopConfig())
    T = keyframes.T_world_imu
    single = {k: prepare_cloud(keyframes.clouds[k], config).native for k in (*range(cut), *chosen)}
    out = []
    for i in chosen:
        found = False
        for j in np.flatnonzero(np.linalg.norm(T[:cut, :3, 3] - T[i, :3, 3], axis=1) < reach).tolist():
            T_j_i = np.ascontiguousarray(se3.inverse(T[j]) @ T[i])
            there = single[j].overlap(1, single[i], 1, T_j_i, 0.5, 1)
            back = single[i].overlap(1, single[j], 1, np.ascontiguousarray(se3.inverse(T_j_i)), 0.5, 1)
            if min(there, back) > _PARTNER:
                found = True
                break
        out.append(found)
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class _Set:
    """Keyframes, those that make the map, and the time between two."""

    keyframes: KeyframeSet
    cut: int
    seconds: float
    patience: float
    inside: Callable[[Array], bool] | None = None


def _hku(data: Path) -> _Set:
    keyframes = read_keyframes(data / "keyframes" / "hku_1")
    return _Set(keyframes=keyframes, cut=int(0.6 * len(keyframes)), seconds=0.4, patience=5.0)


def _part(keyframes: KeyframeSet, share: float) -> _Set:
    return _Set(keyframes=keyframes, cut=int(share * len(keyframes)), seconds=0.8, patience=12.0)


def _in_corridor(T: Array) -> bool:
    return bool(0.0 < T[0, 3] < worlds.STOREYS_LENGTH)


def _alike(keyframes: KeyframeSet) -> _Set:
    """Return a set of equal corridors: patience enough to walk out of one of 40 m."""
    cut = int(0.66 * len(keyframes))
    return _Set(keyframes=keyframes, cut=cut, seconds=0.8, patience=50.0, inside=_in_corridor)


SETS = {
    "hku_1": _hku,
    "building": lambda _: _alike(worlds.building(1)),
    "corridors": lambda _: _alike(worlds.corridors(0)),
    "warehouse": lambda _: _part(worlds.warehouse_laps(1), 0.5),
    "street": lambda _: _part(worlds.street_and_back(1), 0.5),
    "campus": lambda _: _part(worlds.campus_laps(1), 0.5),
}
"""Name -> what makes the set; the map is its first part, the kidnaps are the rest."""


def measure(name: str, data: Path, *, every: int = 1, bare: bool = False, elsewhere: str = "") -> dict[str, Any]:
    """Kidnap in one set, or with ``elsewhere`` in the map of another one: nothing must lock there."""
    some = SETS[name](data)
    T, clouds = some.keyframes.T_world_imu[: some.cut], some.keyframes.clouds[: some.cut]
    if bare:
        points = np.concatenate([transformed(cloud, pose) for cloud, pose in zip(clouds, T, strict=True)])
        saved = map_of_points(np.ascontiguousarray(points, dtype=np.float32))
    else:
        saved = map_of_keyframes(clouds, T)
    walker = SETS[elsewhere](data) if elsewhere else some
    chosen = range(walker.cut, len(walker.keyframes) - 3, every)
    there = [False] * len(chosen) if elsewhere else partners(walker.keyframes, walker.cut, chosen)
    out = kidnaps(
        saved,
        walker.keyframes,
        chosen,
        seconds=walker.seconds,
        patience=walker.patience,
        partner=there,
        inside=walker.inside,
    )
    return {"set": name, "bare": bare, "elsewhere": elsewhere, "submaps": len(saved), **out.facts()}


if __name__ == "__main__":
    import argparse
    import json

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=list(SETS))
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--bare", action="store_true")
    parser.add_argument("--elsewhere", default="")
    given = parser.parse_args()
    print(json.dumps(measure(given.name, given.data, every=given.every, bare=given.bare, elsewhere=given.elsewhere)))
