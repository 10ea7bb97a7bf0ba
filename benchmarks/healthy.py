"""What runs say of healthy recordings: verdicts, repairs, and whether the path is right, over scenarios and seeds.

A repair of data that are sound is worse than none, and a check that cries wolf is switched off. Each recording is
simulated and run whole, with the back-end, in this process; the reader's own repairs (clock steps, bunched stamps) see
no files here and are not counted.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from heliograph import pipeline
from heliograph.config import RunConfig
from heliograph.data import Event, Message, Rig, ScanResult, Trajectory
from heliograph.metrics import evaluate
from heliograph.sim import SCENARIOS, Scenario, simulate

__all__ = ["HEALTHY_SCENARIOS", "InMemory", "Poses", "healthy_section", "measure_healthy"]

_Rows = list[dict[str, Any]]

HEALTHY_SCENARIOS: dict[str, Scenario] = {
    name: SCENARIOS[name].thinned(beams=16, columns=columns, duration=duration)
    for name, columns, duration in (
        ("warehouse", 256, 12.0),
        ("demo", 256, 12.0),
        ("room", 180, 10.0),
        ("calibration", 180, 12.0),
        ("planar", 180, 12.0),
        ("level-straight", 256, 10.0),
        ("level-turns", 256, 12.0),
        ("field", 256, 10.0),
        ("start-turning", 180, 8.0),
        ("start-shaking", 180, 8.0),
    )
}


class InMemory:
    """A simulated recording that can be read again."""

    sensors = frozenset({"lidar", "imu"})
    repeatable = True
    events: Sequence[Event] = ()
    description = "simulated"

    def __init__(self, scenario: Scenario, seed: int) -> None:
        simulation = simulate(scenario, seed)
        self.rig: Rig = simulation.rig
        self.truth = simulation.truth
        self._messages: list[Message] = list(simulation)

    def stream(self) -> Iterator[Message]:
        """Yield the messages."""
        return iter(self._messages)

    def close(self) -> None:
        """Nothing is open."""


class Poses:
    """A sink that keeps stamps and poses, and how long each came after its scan [s]."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forget what came."""
        self.stamps_ns: list[int] = []
        self.poses: list[np.ndarray] = []
        self.waited_s: list[float] = []
        self._latest_ns = 0

    def observe(self, message: Message) -> None:
        """Note when it came."""
        self._latest_ns = max(self._latest_ns, message.received_ns)

    def add(self, result: ScanResult) -> None:
        """Keep a scan's pose."""
        self.stamps_ns.append(result.end_ns)
        self.poses.append(result.T_odom_imu)
        self.waited_s.append((self._latest_ns - result.end_ns) * 1e-9)

    def close(self, summary: object) -> None:
        """Nothing is open."""


def measure_healthy(seeds: Iterable[int], names: Iterable[str] = ()) -> Iterator[dict[str, Any]]:
    """Yield one row a recording: status, verdicts that are no PASS, repairs, ATE [m]."""
    chosen = list(names) or list(HEALTHY_SCENARIOS)
    for seed in seeds:
        for name in chosen:
            source, poses = InMemory(HEALTHY_SCENARIOS[name], seed), Poses()
            summary = pipeline.run(source, RunConfig(threads=1), sinks=[poses])
            stamps = np.array(poses.stamps_ns, dtype=np.int64)
            found = Trajectory(stamps_ns=stamps, T_frame_body=np.stack(poses.poses))
            truth = Trajectory(stamps_ns=stamps, T_frame_body=source.truth.pose(stamps))
            said = {f.code: f"{f.verdict}: {f.evidence}" for f in summary.findings if f.verdict in ("warn", "fail")}
            yield {
                "kind": "healthy",
                "scenario": name,
                "seed": seed,
                "status": summary.status,
                "reasons": list(summary.reasons),
                "said": said,
                "repairs": [repair.code for repair in summary.repairs],
                "ate_m": evaluate(found, truth).absolute.rmse,
                "checks_share": summary.seconds.get("checks", 0.0) / max(summary.wall_seconds, 1e-9),
            }


def healthy_section(rows: _Rows, table: Callable[[Sequence[str], Sequence[Any]], str]) -> str:
    """Return the section of a set of rows."""
    head = ["scenario", "runs", "ok", "WARN", "FAIL", "repaired", "ATE, median / worst [mm]", "checks [% of a run]"]
    body = []
    for name in dict.fromkeys(row["scenario"] for row in rows):
        some = [row for row in rows if row["scenario"] == name]
        verdicts = Counter(text.split(":")[0] for row in some for text in row["said"].values())
        ate = 1e3 * np.array([row["ate_m"] for row in some])
        share = 100.0 * float(np.median([row["checks_share"] for row in some]))
        counts = [len(some), sum(row["status"] == "ok" for row in some), verdicts["warn"], verdicts["fail"]]
        repaired = sum(bool(row["repairs"]) for row in some)
        body.append([name, *counts, repaired, f"{np.median(ate):.1f} / {ate.max():.1f}", f"{share:.1f}"])
    return (
        "\n## Healthy recordings\n\nWhat the checks inside a run say of sound simulated recordings of 8 to 12 s: no "
        "repair, no FAIL, at most one WARN in\n20 are wanted; the checks' share of a run's wall time is to be 3 % or "
        "less (bar).\n\n" + table(head, body)
    )


def main(arguments: Sequence[str]) -> None:
    """``python -m benchmarks.healthy FIRST LAST [SCENARIO...]``: one line a run, and the table."""
    first, last, *names = arguments
    rows: _Rows = []
    for row in measure_healthy(range(int(first), int(last) + 1), names):
        rows.append(row)
        said = "; ".join((*row["said"].values(), *row["reasons"]))
        mark = "   " if row["status"] == "ok" and not row["said"] and not row["repairs"] else "!! "
        repairs = ",".join(row["repairs"]) or "no repair"
        print(
            f"{mark}{row['scenario']} {row['seed']}: {row['status']}, {1e3 * row['ate_m']:.1f} mm, {repairs} {said}",
            flush=True,
        )
    print(healthy_section(rows, _table))


def _table(head: Sequence[str], body: Sequence[Any]) -> str:
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


if __name__ == "__main__":
    main(sys.argv[1:])
