"""The sections of BENCHMARKS.md on incremental smoothing."""

from __future__ import annotations

from typing import Any

__all__ = ["incremental_scale_section", "incremental_section"]

_Rows = list[dict[str, Any]]


def incremental_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return incremental smoothing: every graph at both skips, ours beside gtsam's."""
    body = [
        [
            row["graph"],
            row["skip"],
            row["system"],
            *(f"{row[key]:.3g}" for key in ("seconds", "mean_ms", "p50_ms", "p99_ms", "max_ms")),
            row["fault"] or f"{row['chi2']:.6g}",
            f"{row['batch_chi2']:.6g}",
        ]
        for row in rows
    ]
    head = ["graph", "skip", "system", "s", "mean ms", "median ms", "99 % ms", "max ms", "last chi2", "batch chi2"]
    return (
        "## Pose graphs, one pose at a time\n\n"
        + table(head, body)
        + "\nUpdate and reading of the one pose from which the next starts; threshold 0.1, wildfire 1e-3, one core; "
        f"medians of {rows[0]['runs']} runs in fresh processes taken in turn."
        + (" `hard`: information from 20 to 4e8.\n" if any(row["graph"] == "hard" for row in rows) else "\n")
    )


def incremental_scale_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return a long drive: what an update takes by tenths of the run."""
    body = []
    for row in (row for row in rows if not row["failed"]):
        body.append(
            [
                row["system"],
                row["updates"],
                *(f"{row[key]:.3g}" for key in ("seconds", "p50_ms", "p99_ms", "max_ms")),
                " ".join(f"{1e3 * x:.0f}" for x in row["deciles_p50_ms"]),
                " ".join(f"{x:.0f}" for x in row["deciles_reeliminated"]),
                " ".join(f"{x:.0f}" for x in row.get("deciles_bytes_a_pose", [])) or "-",
            ]
        )
    head = [
        "system",
        "poses",
        "s",
        "median ms",
        "99 % ms",
        "max ms",
        "median us by tenths",
        "re-eliminated",
        "bytes a pose",
    ]
    return (
        f"## A drive of {rows[0]['poses']} poses, one at a time\n\n"
        + table(head, body)
        + "\nLoops as in kitti_00; full smoother, skip 1. A run ends when its time is over.\n"
    )
