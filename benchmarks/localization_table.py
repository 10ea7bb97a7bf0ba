"""All of localisation and merging that the table shows, and its section."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks import localization, localization_changed, merging

__all__ = ["localization_section", "measure_localization"]

_KIDNAPS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("hku_1", {}),
    ("hku_1", {"bare": True, "every": 3}),
    ("warehouse", {"every": 2}),
    ("warehouse", {"bare": True, "every": 3}),
    ("street", {}),
    ("campus", {"every": 26}),
    ("corridors", {}),
    ("building", {"every": 4}),
    ("warehouse", {"every": 2, "elsewhere": "hku_1"}),
    ("hku_1", {"every": 3, "elsewhere": "warehouse"}),
    ("street", {"every": 3, "elsewhere": "warehouse"}),
)
_CHANGED = (("demo", 201, 0.5), ("demo", 203, 1.0), ("warehouse", 205, 1.0))
_MERGES = (211, 212, 213)

_KIDNAPPED = (
    "Kidnaps: a map of a set's first keyframes, then a robot that wakes up at later ones with an odometry of its own "
    "(0.05 deg and 5 mm a keyframe) and walks on. A lock is right within 0.5 m and 5 deg; to find are those with 30 % "
    "of a keyframe of the map in view. `bare`: the map is a cloud without poses. `A in B`: who walks in A has the map "
    "of B, and must never lock. A query is CPU time of a global search. Corridors and building: 40 m long and equal, "
    "the walk goes on until one has left; who is not found when the set ends had left too late for three queries."
)
_SECOND_LAP = (
    "A second lap by odometry and localisation at 10 Hz in a place where things have moved; ideal NEES is 6. Time: of "
    "localisation over the odometry's, in the same process, searches included."
)
_MERGED = (
    "Three runs merged from their folders: the beginning of a walk, its end from before that in motion, and another "
    "place. Distances from the truth in the first run's frame, and of the map's points from the true surfaces."
)

_Table = Callable[[Sequence[str], Sequence[Sequence[str]]], str]


def measure_localization(data: Path) -> Iterator[dict[str, Any]]:
    """Yield a row a set of kidnaps, a changed lap, and a merge."""
    for name, settings in _KIDNAPS:
        yield {"kind": "kidnaps", **localization.measure(name, data, **settings)}
    for scenario, seed, share in _CHANGED:
        yield {"kind": "changed", **localization_changed.measure(scenario, seed, share)}
    for seed in _MERGES:
        yield {"kind": "merge", **merging.measure(seed)}


def localization_section(rows: Sequence[dict[str, Any]], table: _Table) -> str:
    """Return the section of localisation."""
    kidnaps, changed, merges = ([r for r in rows if r["kind"] == kind] for kind in ("kidnaps", "changed", "merge"))
    return "\n".join([
        "## Localisation in a saved map, and merging", "", _KIDNAPPED, "", _kidnaps(kidnaps, table), "",
        _SECOND_LAP, "", _changed(changed, table), "", _MERGED, "", _merges(merges, table), "",
    ])  # fmt: skip


def _kidnaps(rows: Sequence[dict[str, Any]], table: _Table) -> str:
    head = ["set", "submaps", "kidnaps", "to find", "right", "false", "else", "lock s median, max",
            "after leaving s, max", "query s median, p99, max", "error m median, max"]  # fmt: skip
    body = []
    for r in rows:
        name = f"{r['elsewhere']} in {r['set']}" if r["elsewhere"] else r["set"] + (", bare" if r["bare"] else "")
        other = ", ".join(f"{count} {state}" for state, count in r["ends"].items() if state != "localised")
        body.append([
            name, str(r["submaps"]), str(r["kidnaps"]), str(r["with_partner"]), str(r["right"]), str(r["false"]), other,
            _numbers(r["lock_s"], 0, 2), _numbers(r["after_leaving_s"], 2), _numbers(r["query_s"], 0, 1, 2),
            _numbers(r["error_m"], 0, 2),
        ])  # fmt: skip
    return table(head, body)


def _numbers(values: Sequence[float], *which: int) -> str:
    return ", ".join("-" if values[k] != values[k] else f"{values[k]:g}" for k in which)


def _changed(rows: Sequence[dict[str, Any]], table: _Table) -> str:
    head = [
        "scenario",
        "seed",
        "things moved",
        "of the returns",
        "scans",
        "localised",
        "ATE mm",
        "max mm",
        "NEES",
        "time",
    ]
    body = [
        [r["scenario"], str(r["seed"]), f"{r['share_of_things']:.0%}", f"{r['share_of_returns']:.0%}", f"{r['scans']}",
         f"{r['localised']:.0%}", *(f"{r[key]}" for key in ("ate_mm", "max_mm", "nees")),
         f"{r['tracking_over_odometry']:.2f}"]
        for r in rows
    ]  # fmt: skip
    return table(head, body)


def _merges(rows: Sequence[dict[str, Any]], table: _Table) -> str:
    head = [
        "seed",
        "links",
        "third session",
        "first RMS, max mm",
        "second RMS, max mm",
        "walls median, p95 mm",
        "first alone",
    ]
    body = []
    for r in rows:
        off, sessions = r["off_mm"], r["sessions"]
        third = "linked" if sessions["elsewhere"]["linked"] else "apart"
        body.append([
            str(r["seed"]), str(sessions["second"]["links"]), third, *(_numbers(off[name], 1, 2) for name in off),
            _numbers(r["wall_mm"], 0, 1), _numbers(r["wall_first_alone_mm"], 0, 1),
        ])  # fmt: skip
    return table(head, body)
