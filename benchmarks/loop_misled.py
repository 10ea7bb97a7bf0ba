"""False candidates among the right ones: what a back-end accepts that is told to look at twins of a place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.loop_worlds import DriftingOdometry, KeyframeSet, corridors
from benchmarks.loops import is_right
from heliograph.arrays import Array
from heliograph.config import RunConfig
from heliograph.lie import se3
from heliograph.registration import align
from heliograph.sim.revisits import STOREYS_PITCH
from heliograph.slam import BackEnd, KeyframeStore
from heliograph.slam.loop_search import Candidate, LoopSearch
from heliograph.slam.loops import LocalMaps, LoopStart, loop_align_config

__all__ = ["measure_misled", "misled_section"]

_SHARE = 0.3  # of the queries that are given a false candidate first
_NAIVE_M, _NAIVE_M2 = 15.0, 0.3  # candidates within this way, and mean squared residual: LIO-SAM's defaults
_APART = 30


class MisledSearch(LoopSearch):
    """A search that is told of twins: corridors that look alike, with a guess that lays one upon the other.

    Parameters
    ----------
    search : LoopSearch
        The back-end's own; what it holds is taken over.
    truth : (K, 4, 4) float64
    seed : int
    """

    def __init__(self, search: LoopSearch, truth: Array, seed: int) -> None:
        self.__dict__.update(search.__dict__)
        self._truth, self._rng = truth, np.random.default_rng([11, seed])
        self.told: dict[int, Candidate] = {}

    def due(self, query: int) -> bool:
        """Look at every keyframe that could have a twin."""
        return super().due(query) or query > _APART

    def candidates(self, query: int, T_map_imu: Array) -> tuple[Candidate, ...]:
        """Return a twin first, for a share of the queries, then what the search finds."""
        found = super().candidates(query, T_map_imu)
        twin = self._twin(query) if self._rng.random() < _SHARE else None
        if twin is None:
            return found
        self.told[query] = twin
        return (twin, *found)

    def _twin(self, query: int) -> Candidate | None:
        T = self._truth
        for shift in self._rng.permutation([STOREYS_PITCH, -STOREYS_PITCH]).tolist():
            alias = se3.from_rotation_translation(np.eye(3), [0.0, shift, 0.0]) @ T[query]
            apart = np.linalg.norm(T[: query - _APART, :3, 3] - alias[:3, 3], axis=1)
            if len(apart) and apart.min() < 1.0:
                match = int(np.argmin(apart))
                guess = np.ascontiguousarray(se3.inverse(T[match]) @ alias)
                return Candidate(match=match, score=1.0, starts=(LoopStart(source="place", T_match_query=guess),))
        return None


def run_misled(keyframes: KeyframeSet, step: float, step_deg: float, seed: int) -> dict[str, Any]:
    """Give one walk to the back-end and mislead it; return what it and a naive gate accept."""
    odometry = DriftingOdometry(keyframes, step, step_deg, seed)
    config = RunConfig()
    config = replace(config, slam=replace(config.slam, loop_every=1, loop_pieces=10_000))
    with TemporaryDirectory() as folder:
        back_end = BackEnd(config, KeyframeStore.create(Path(folder)))
        search = MisledSearch(back_end._search, keyframes.T_world_imu, seed)
        back_end._search = search
        for keyframe in odometry.as_keyframes():
            back_end.add(keyframe)
        naive = _naively_accepted(search, back_end, odometry)
        back_end.store.close()
    accepted = [entry.evidence for entry in back_end.ledger.accepted()]
    right = [is_right(e.match, e.query, e.T_match_query, keyframes) for e in accepted]
    revisited = _revisited(keyframes)
    closed = {e.query for e, ok in zip(accepted, right, strict=True) if ok}
    return {
        "seed": seed, "step_m": step, "step_deg": step_deg, "keyframes": len(keyframes), "told": len(search.told),
        "naive": naive, "accepted": len(accepted), "false": right.count(False), "revisited": len(revisited),
        "closed": len(closed & revisited),
    }  # fmt: skip


def _revisited(keyframes: KeyframeSet) -> set[int]:
    p = keyframes.T_world_imu[:, :3, 3]
    return {k for k in range(_APART + 1, len(p)) if np.linalg.norm(p[: k - _APART] - p[k], axis=1).min() < 1.0}


def _naively_accepted(search: MisledSearch, back_end: BackEnd, odometry: DriftingOdometry) -> int:
    """Count the false candidates that a gate by distance and fitness accepts."""
    maps = LocalMaps(back_end.store, loop_align_config(RunConfig().loops))
    accepted = 0
    for query, twin in search.told.items():
        if np.linalg.norm(odometry.T[query, :3, 3] - odometry.T[twin.match, :3, 3]) > _NAIVE_M:
            continue
        target = maps.around(twin.match, max(0, twin.match - 5), twin.match + 5)
        source = maps.around(query, query, query)
        found = align(target, source, start=twin.starts[0].T_match_query, config=maps.config)
        accepted += found.T_target_source is not None and found.residuals.rms**2 < _NAIVE_M2
    return accepted


def measure_misled(
    seeds: Iterable[int],
    drifts: Sequence[tuple[float, float]] = ((0.005, 0.05), (0.02, 0.2)),
    report: Callable[[dict[str, Any]], object] = str,
) -> list[dict[str, Any]]:
    """Mislead the back-end in three corridors that are alike, with every drift and seed."""
    rows = []
    for seed in seeds:
        keyframes = corridors(seed)
        for step, step_deg in drifts:
            rows.append(run_misled(keyframes, step, step_deg, seed))
            report(rows[-1])
    return rows


def misled_section(rows: Sequence[dict[str, Any]], table: Callable[[list[str], list[list[str]]], str]) -> str:
    """Return the section of BENCHMARKS.md."""
    head = ["walk a keyframe", "seeds", "told", "naive gate accepts", "accepted", "false", "revisits closed"]
    body = []
    for step in dict.fromkeys(r["step_m"] for r in rows):
        some = [r for r in rows if r["step_m"] == step]
        total = {
            key: sum(r[key] for r in some) for key in ("told", "naive", "accepted", "false", "revisited", "closed")
        }
        body.append([
            f"{step:g} m, {some[0]['step_deg']:g} deg", str(len(some)), str(total["told"]), str(total["naive"]),
            str(total["accepted"]), str(total["false"]), f"{total['closed'] / max(total['revisited'], 1):.3f}",
        ])  # fmt: skip
    return "\n".join([
        "## Loops: misled", "",
        "Corridors that are alike, walked one after the other and the first once more (odd seeds: the other way). At "
        "three of ten queries the back-end is told first of a twin, the same place one corridor on, with a guess that "
        "lays one upon the other. The naive gate accepts a registration of a scan to the candidate's map within "
        "15 m by the odometry, if its mean squared residual is below 0.3 m2.",
        "", table(head, body), "",
    ])  # fmt: skip
