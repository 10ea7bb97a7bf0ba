"""The sections of BENCHMARKS.md on inertial data."""

from __future__ import annotations

from typing import Any

__all__ = ["gnss_section", "lio_section", "preintegration_section"]

_Rows = list[dict[str, Any]]
_RATIO = 0.2  # of gtsam's loop in Python, at most


def preintegration_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return time a sample."""
    body = [[f"{r['system']} {r['version']}", r["call"], f"{r['us_a_sample']:.3f}"] for r in rows]
    text = "## Preintegration\n\n" + table(["system", "call", "us a sample"], body)
    text += (
        "\n400 samples at 400 Hz, one second, one thread. Ours returns motion, derivative by the biases, the 9 x 9 "
        "covariance and the 15 x 15 one with walking biases; gtsam's wheel takes samples one by one.\n"
    )
    rival = [r["us_a_sample"] for r in rows if r["system"] == "gtsam"]
    if rival:
        share = max(r["us_a_sample"] for r in rows if r["system"] == "heliograph") / min(rival)
        text += f"Our slower call takes {share:.2f} of gtsam's faster loop (bar: {_RATIO}).\n"
    return text


def gnss_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return the real drive with noisy fixes, and the cuts."""
    scored = [r for r in rows if r["method"] != "cuts"]
    body = [[f"{r['system']} {r['version']}", r["method"], f"{r['rmse_m']:.4f}", f"{r['seconds']:.2f}"] for r in scored]
    first = rows[0]
    text = "## IMU and 1 Hz fixes: KITTI 00, 470 s, 3.7 km\n\n" + table(["system", "method", "RMSE m", "s"], body)
    text += (
        f"\nFixes with white noise of 1 m a horizontal axis and 2 m vertically: {first['noisy_rmse_m']:.3f} m. "
        "All systems get the same readings, noise, fixes and start. Batch: all at once; incremental: one update a fix. "
        "Bars: half of the fixes' error, 1.02 of gtsam's. The IMU's stamps lag the fixes' by "
        f"{first['lag_ms']:.0f} +- {first['lag_sigma_ms']:.0f} ms by the likelihood of the fixes. IMU noise is the "
        "file's own, that of held samples the likeliest (`benchmarks/imu_likelihood.py`). Eight gaps of "
        "1.6 s, which the file fills with straight lines in samples, fixes and truth, are found and left open.\n"
    )
    for method in ("batch", "incremental"):
        by = {r["system"]: r["rmse_m"] for r in scored if r["method"] == method}
        if "gtsam" in by:
            text += f"{method.capitalize()}: {by['heliograph'] / by['gtsam']:.4f} of gtsam's error. "
    for r in (r for r in rows if r["method"] == "cuts"):
        low, high = r["band"]
        verdict = "inside" if low <= r["mean_nees"] <= high else "outside"
        text += (
            f"\n\nFixes cut for 30 s at {r['cuts']} places: mean normalised squared error of the predicted position "
            f"{r['mean_nees']:.2f}, {verdict} its 95 % band [{low:.2f}, {high:.2f}] (3 expected). Median drift "
            f"{r['median_drift_m']:.1f} m horizontally and {r['median_vertical_m']:.1f} m vertically over "
            f"{r['median_path_m']:.0f} m; in the {r['cuts_with_imu_gap']} cuts in which the IMU itself has a gap of "
            f"1.6 s, {r['median_drift_gap_m']:.0f} m.\n"
        )
    return text


def lio_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return LiDAR-inertial graphs on the real drive, one keyframe at a time."""
    body = [
        [
            r["graph"],
            f"{r['system']} {r['version']}",
            f"{r['total_s']:.2f}",
            f"{r['median_ms']:.2f}",
            f"{r['p99_ms']:.2f}",
            f"{r['max_ms']:.2f}",
            f"{r['covariance_ms']:.2f}",
            f"{r['rmse_m']:.3f}",
        ]
        for r in rows
    ]
    head = ["graph", "system", "total s", "update ms", "p99 ms", "max ms", "covariance ms", "RMSE m"]
    text = "## LiDAR-inertial graphs: KITTI 00, 451 keyframes\n\n" + table(head, body)
    text += (
        "\nReal IMU; LiDAR steps and loops drawn about the truth (2 mrad, 5 cm), fixes of an antenna on a lever arm "
        "(1 m a horizontal axis, 2 m vertically). `lio`: steps, loops, every fifth fix; `gnss`: loops, all fixes. "
        "One update a keyframe; total is all of the loop, factors built and states predicted included, preintegration "
        "not. CPU time of one thread, medians over alternated runs. Bars: a third of gtsam's.\n"
    )
    for name in dict.fromkeys(r["graph"] for r in rows):
        by = {r["system"]: r for r in rows if r["graph"] == name}
        if "gtsam" in by:
            keys = {"total_s": "total", "median_ms": "median", "p99_ms": "p99"}
            shares = [f"{label} {by['heliograph'][k] / by['gtsam'][k]:.2f}" for k, label in keys.items()]
            text += f"\n`{name}`, of gtsam's: {', '.join(shares)}."
    return text + "\n"
