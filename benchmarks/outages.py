"""Silences of the sensors in mid-recording: whether scans find their place in the map again, or a new piece is told.

Either LiDAR, IMU or both fall silent for 0.3 to 30 s, at rest, walking and waved about by hand. After it the path must
be within 20 mm of the truth, or a new piece of map must be told of and the run be ``degraded``; anything else is silent
failure. Truth is exact; every recording is simulated and run whole in this process.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.healthy import InMemory, Poses
from heliograph import pipeline
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Scan, Trajectory
from heliograph.metrics import evaluate
from heliograph.sim import SCENARIOS, Scenario

__all__ = ["OUTAGES_S", "OUTAGE_MOTIONS", "measure_outages", "outages_section"]

_Rows = list[dict[str, Any]]

OUTAGES_S = (0.3, 0.5, 0.7, 1.0, 2.0, 5.0, 10.0, 30.0)
_SILENT: dict[str, tuple[type, ...]] = {"both": (Scan, ImuBatch), "lidar": (Scan,), "imu": (ImuBatch,)}
_BEGIN_S, _AFTER_S = 7.0, 8.0  # the silence begins so long after the first message; the recording goes on after it
_MAX_ATE = 0.02  # of the path with what comes after the silence, the bar [m]


def _motion(scenario: str, *, speed: float, rest: float) -> Scenario:
    scene = SCENARIOS[scenario].thinned(beams=16, columns=256)
    return replace(scene, walk=replace(scene.walk, speed=speed, rest=rest, ramp=1.0, after=20.0))


# 0.45 m/s: 30 s of it do not lead beyond the room's course.
OUTAGE_MOTIONS: dict[str, Scenario] = {
    "still": _motion("room", speed=0.45, rest=60.0),
    "walking": _motion("room", speed=0.45, rest=2.0),
    "waved": _motion("calibration", speed=0.45, rest=2.0),
    "warehouse": _motion("warehouse", speed=1.4, rest=2.0),
}


class _Silenced(InMemory):
    """A simulated recording in which some messages are missing."""

    def __init__(self, scenario: Scenario, seed: int, kinds: tuple[type, ...], seconds: float) -> None:
        length = _BEGIN_S + seconds + _AFTER_S
        super().__init__(replace(scenario, walk=replace(scenario.walk, duration=length)), seed)
        begin = self._messages[0].received_ns + round(1e9 * _BEGIN_S)
        self.silence_ns = (begin, begin + round(1e9 * seconds))
        self._messages = [
            m for m in self._messages if not (isinstance(m, kinds) and begin <= m.received_ns < self.silence_ns[1])
        ]


def measure_outages(
    seeds: Iterable[int],
    *,
    motions: Sequence[str] = (),
    seconds: Sequence[float] = OUTAGES_S,
    silent: Sequence[str] = tuple(_SILENT),
) -> Iterator[dict[str, Any]]:
    """Yield one row a silence: ATE over the whole and its worst pose after it [m], status, and what was said."""
    for seed in seeds:
        for motion in motions or OUTAGE_MOTIONS:
            for length in seconds:
                for sensors in silent:
                    yield _row(motion, seed, sensors, length)


def _row(motion: str, seed: int, sensors: str, seconds: float) -> dict[str, Any]:
    source, poses = _Silenced(OUTAGE_MOTIONS[motion], seed, _SILENT[sensors], seconds), Poses()
    summary = pipeline.run(source, RunConfig(threads=1), sinks=[poses])
    stamps = np.array(poses.stamps_ns, dtype=np.int64)
    # A scan that lies in the silence of the other sensor is bridged, not found again: what comes after is judged.
    judged = (stamps < source.silence_ns[0]) | (stamps > source.silence_ns[1] + 200_000_000)
    after = stamps > source.silence_ns[1]
    waited = max((wait for wait, late in zip(poses.waited_s, after, strict=True) if late), default=0.0)
    stamps, T = stamps[judged], np.stack(poses.poses)[judged]
    truth = Trajectory(stamps_ns=stamps, T_frame_body=source.truth.pose(stamps))
    way = "origin" if motion == "still" else "se3"  # one place leaves the rotation open
    errors = evaluate(Trajectory(stamps_ns=stamps, T_frame_body=T), truth, align=way).absolute
    codes = sorted({event.code for event in summary.events})
    told = "new-piece" in codes and summary.status != "ok"
    return {
        "kind": "outage",
        "motion": motion,
        "seed": seed,
        "silent": sensors,
        "seconds": seconds,
        "ate_m": errors.rmse,
        "worst_m": errors.max,
        "scans_after": int(np.count_nonzero(after)),
        "waited_s": waited,
        "status": summary.status,
        "reasons": list(summary.reasons),
        "said": codes,
        "repairs": [repair.code for repair in summary.repairs],
        "outcome": "right" if errors.rmse <= _MAX_ATE else "told" if told else "silent",
    }


def outages_section(rows: _Rows, table: Callable[[Sequence[str], Sequence[Any]], str]) -> str:
    """Return the section of a set of rows."""
    head = [
        "motion",
        "silent",
        "silence [s]",
        "runs",
        "right",
        "told",
        "silent failures",
        "ATE, median / worst [mm]",
        "held back, longest [s]",
    ]
    body = []
    for motion, sensors in dict.fromkeys((row["motion"], row["silent"]) for row in rows):
        alike = [row for row in rows if (row["motion"], row["silent"]) == (motion, sensors)]
        for seconds in sorted({row["seconds"] for row in alike}):
            some = [row for row in alike if row["seconds"] == seconds]
            outcomes = [row["outcome"] for row in some]
            ate = 1e3 * np.array([row["ate_m"] for row in some if row["outcome"] != "told"])
            shown = f"{np.median(ate):.1f} / {ate.max():.1f}" if len(ate) else ""
            counts = [outcomes.count(outcome) for outcome in ("right", "told", "silent")]
            waits = [row["waited_s"] for row in some if "waited_s" in row]
            held = f"{max(waits):.1f}" if waits else ""
            body.append([motion, sensors, f"{seconds:g}", len(some), *counts, shown, held])
    return (
        "\n## Silences of the sensors\n\nBoth sensors or one fall silent in mid-recording; seeds from 200 on. The path "
        "before and after is to be within 20 mm of\nthe truth (bar, right), or the run `degraded` with a new piece of "
        "map (told). ATE is of those that tell of no new piece.\nResults of scans without a "
        "place are held back until one has it.\n\n" + table(head, body)
    )


def main(arguments: Sequence[str]) -> None:
    """``python -m benchmarks.outages FIRST LAST [MOTION,... [SECONDS,... [SILENT,...]]]``: one line a run."""
    first, last, *lists = arguments
    motions, seconds, silent = ([word for word in text.split(",") if word] for text in (*lists, "", "", "")[:3])
    rows = measure_outages(
        range(int(first), int(last) + 1),
        motions=motions,
        seconds=[float(word) for word in seconds] or OUTAGES_S,
        silent=silent or tuple(_SILENT),
    )
    for row in rows:
        mark = {"right": "   ", "told": "t  ", "silent": "!! "}[row["outcome"]]
        print(
            f"{mark}{row['motion']} {row['silent']} {row['seconds']:g} s, seed {row['seed']}: {row['status']}, "
            f"{1e3 * row['ate_m']:.1f} mm, worst {1e3 * row['worst_m']:.1f} mm, {','.join(row['said'])} "
            f"{'; '.join(row['reasons'])[:200]}",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
