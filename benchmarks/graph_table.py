"""The sections of BENCHMARKS.md on pose graphs."""

from __future__ import annotations

from typing import Any

from benchmarks.graph_scale import exponent

__all__ = ["graph_section", "graph_summary", "scale_section"]

_Rows = list[dict[str, Any]]
_BAR = 0.5  # at most this part of the fastest rival's time
_TIME_EXPONENT, _MEMORY_EXPONENT, _PEAK_GB = 1.4, 1.15, 8.0


def graph_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return the race to the optimum: one summary a graph, then every solver."""
    names = list(dict.fromkeys(row["graph"] for row in rows))
    body, lost = [], []
    for name in names:
        part = [row for row in rows if row["graph"] == name]
        ours, best = _fastest(part, ours=True), _fastest(part, ours=False)
        if ours is None or best is None:
            continue
        ratio = ours["seconds"] / best["seconds"]
        if ratio > _BAR:
            lost.append(f"{name} ({ratio:.2f})")
        body.append(
            [
                name,
                ours["poses"],
                ours["edges"],
                _called(ours),
                f"{1e3 * ours['seconds']:.2f}",
                _called(best),
                f"{1e3 * best['seconds']:.2f}",
                f"{ratio:.2f}",
                f"{ours['chi2']:.6g}",
            ]
        )
    head = ["graph", "poses", "edges", "ours", "ms", "fastest rival at the optimum", "ms", "ratio", "chi2"]
    text = "## Pose graphs: time to the optimum\n\n" + table(head, body)
    text += (
        "\nOne core, start from odometry, stop at a relative decrease of 1e-5; ordering, symbolic work and all "
        f"iterations, reading and construction excluded; median of {rows[0]['runs']} runs in fresh processes taken in "
        "turn, each after one to warm up. Solutions of all are scored by one chi2; the optimum is reached within 1e-4. "
        f"Bar: {_BAR} of the fastest rival's time. "
    )
    text += f"Missed on {', '.join(lost)}.\n" if lost else "Kept on every graph.\n"
    every = [
        [
            row["graph"],
            _called(row),
            "failed" if row["failed"] else f"{1e3 * row['seconds']:.2f}",
            "-" if row["failed"] else row["iterations"],
            "-" if row["failed"] else f"{row['chi2']:.6g}",
            "yes" if row["reached"] else "no",
        ]
        for row in rows
    ]
    return text + "\nEvery solver:\n\n" + table(["graph", "solver", "ms", "iterations", "chi2", "optimum"], every)


def graph_summary(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return ours and the fastest of the others, a line a graph."""
    body = []
    for name in dict.fromkeys(row["graph"] for row in rows):
        part = [row for row in rows if row["graph"] == name]
        ours, best = _fastest(part, ours=True), _fastest(part, ours=False)
        if ours is not None and best is not None:
            times = [f"{1e3 * row['seconds']:.1f}" for row in (ours, best)]
            body.append([name, ours["poses"], ours["edges"], times[0], times[1], _called(best)])
    return table(["graph", "poses", "edges", "ours ms", "next ms", "the next fastest at the optimum"], body)


def scale_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return time and memory against size, with the exponents and the rivals where they ran."""
    body = [
        [
            row["graph"],
            row["poses"],
            row["edges"],
            _called(row),
            "failed" if row["failed"] else f"{row['seconds']:.2f}",
            "-" if row["failed"] else row["iterations"],
            "-" if row["failed"] else f"{row['peak_mb']:.0f}",
            "yes" if row.get("reached") else "no",
        ]
        for row in rows
    ]
    head = ["graph", "poses", "edges", "solver", "s", "iterations", "peak MB", "optimum"]
    text = "## Pose graphs of growing size\n\n" + table(head, body)
    text += (
        "\nGenerated worlds of constant density, one core, start from odometry, one run a process without warming up; "
        "`auto` may take a chordal start instead, within its time. "
    )
    mine = [r for r in rows if r["system"] == "heliograph" and r["graph"].startswith("manhattan") and not r["failed"]]
    if len(mine) > 1:
        sizes = [row["poses"] for row in mine]
        times = exponent(sizes, [row["seconds"] for row in mine])
        memory = exponent(sizes, [row["peak_mb"] for row in mine])
        beyond = exponent(sizes, [row["peak_mb"] - (row["base_mb"] or 0.0) for row in mine])
        peak = max(row["peak_mb"] for row in mine) / 1e3
        text += (
            f"Of Manhattan worlds time grows with exponent {times:.2f} (bar: {_TIME_EXPONENT}), peak memory with "
            f"{memory:.2f} (bar: {_MEMORY_EXPONENT}), its part beyond the bare program with {beyond:.2f}; the largest "
            f"peak is {peak:.1f} GB (bar: {_PEAK_GB:g}). "
        )
    for name in dict.fromkeys(row["graph"] for row in rows):
        part = [row for row in rows if row["graph"] == name]
        ours, best = _fastest(part, ours=True), _fastest(part, ours=False)
        if ours is not None and best is not None:
            text += f"{name}: {ours['seconds'] / best['seconds']:.2f} times {_called(best)}'s time (bar: {_BAR}). "
    return text.rstrip() + "\n"


def _fastest(rows: _Rows, *, ours: bool) -> dict[str, Any] | None:
    """Return the fastest row that reached the optimum, among ours or among the rivals'; ours is the default method."""
    found = [row for row in rows if (row["system"] == "heliograph") == ours and row.get("reached")]
    if ours:
        found = [row for row in found if row["options"] in (["lm"], ["lm", "auto"])]
    return min(found, key=lambda row: row["seconds"], default=None)


def _called(row: dict[str, Any]) -> str:
    short = {"MULTIFRONTAL_CHOLESKY": "multifrontal", "SEQUENTIAL_CHOLESKY": "sequential"}
    version = [row["version"]] if "version" in row else []
    return " ".join([row["system"], *version, *(short.get(word, word) for word in row["options"])])
