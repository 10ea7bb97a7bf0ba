"""The charts of a run, each from the scan table alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from heliograph.output.record import RunRecord
from heliograph.output.scan_log import ScanTable
from heliograph.report.colors import OBSERVABILITY, css_gradient
from heliograph.report.hover import hover_attributes
from heliograph.report.svg import Axis, Line, Span, line_chart, nice_ticks, number, polyline, text

__all__ = [
    "biases",
    "centre_axis",
    "eigenvalues",
    "equal_grid",
    "matching",
    "motion",
    "timings",
    "trajectory",
    "uncertainty",
]

_EVEN_SHARE = 1.0 / 3.0  # each translation eigenvalue where all directions are observed alike
_NAMES_APART = 130.0  # pixels, of the picture at its full width
_MIN_SHOWN_SHARE = 1e-3
_XYZ = ("x", "y", "z")
VERDICT_WORDS = {
    "degenerate": "a direction unobservable",
    "predicted": "not matched, predicted",
    "lost": "lost",
    "empty": "empty scan",
}


def verdict_spans(scans: ScanTable) -> list[Span]:
    """Return the stretches of time in which something was wrong."""
    spans: list[Span] = []
    seconds = scans.seconds
    for status, first, last in _runs(scans.statuses):
        if status in VERDICT_WORDS:
            end = seconds[min(last + 1, len(seconds) - 1)]
            spans.append(Span(low=float(seconds[first]), high=float(end), kind=f"v-{status}"))
    return spans[:2000]


def _runs(values: list[str]) -> Iterator[tuple[str, int, int]]:
    """Yield value, first and last index of each stretch of equal values."""
    first = 0
    for i in range(1, len(values) + 1):
        if i == len(values) or values[i] != values[first]:
            yield values[first], first, i - 1
            first = i


def motion(scans: ScanTable) -> list[str]:
    """Return charts of speed and height."""
    speed = np.linalg.norm(scans.triple("velocity"), axis=1)
    height = scans.triple("position")[:, 2]
    return [
        line_chart(scans.seconds, [Line(y=speed, color=1)], title="Speed", y_label="speed [m/s]", floor=0.0),
        line_chart(scans.seconds, [Line(y=height, color=2)], title="Height", y_label="z in the map [m]"),
    ]


def biases(scans: ScanTable) -> list[str]:
    """Return charts of the IMU's biases with their one-sigma bands."""
    charts = []
    for name, title, unit in (("gyro_bias", "Gyroscope bias", "mrad/s"), ("accel_bias", "Accelerometer bias", "mm/s²")):
        values, sigmas = 1e3 * scans.triple(name), 1e3 * scans.triple(f"sigma_{name}")
        lines = [Line(y=values[:, i], sigma=sigmas[:, i], color=i + 1, label=_XYZ[i]) for i in range(3)]
        charts.append(line_chart(scans.seconds, lines, title=f"{title}, band 1σ", y_label=f"bias [{unit}]"))
    return charts


def uncertainty(scans: ScanTable) -> list[str]:
    """Return charts of the pose sigmas as the filter believes them."""
    charts = []
    for name, title, unit, factor in (
        ("sigma_position", "Position sigma, map axes", "mm", 1e3),
        ("sigma_rotation", "Rotation sigma, body axes", "mdeg", 1e3 * 180.0 / np.pi),
    ):
        values = factor * scans.triple(name)
        lines = [Line(y=values[:, i], color=i + 1, label=_XYZ[i]) for i in range(3)]
        charts.append(line_chart(scans.seconds, lines, title=title, y_label=f"sigma [{unit}]", floor=0.0))
    return charts


def eigenvalues(scans: ScanTable) -> list[str]:
    """Return charts of what the scans could and could not see, on logarithmic ordinates."""
    charts, names = [], ("weakest", "middle", "strongest")
    for name, title in (
        ("eigenvalue_translation", "Observability of translation"),
        ("eigenvalue_rotation", "Observability of rotation"),
    ):
        values = np.where(scans.triple(name) > 0.0, scans.triple(name), np.nan)
        lines = [Line(y=values[:, i], color=(5, 2, 1)[i], label=names[i]) for i in range(3)]
        charts.append(
            line_chart(
                scans.seconds, lines, title=title, y_label="eigenvalue [1]", log=True, spans=verdict_spans(scans)
            )
        )
    return charts


def matching(scans: ScanTable) -> list[str]:
    """Return charts of the residuals and of the share of points that found a plane."""
    queries = np.maximum(np.asarray(scans["queries"], dtype=np.float64), 1.0)
    matched = np.where(scans["queries"] > 0, 100.0 * scans["matches"] / queries, np.nan)
    residual = 1e3 * np.asarray(scans["rms"], dtype=np.float64)
    return [
        line_chart(
            scans.seconds, [Line(y=residual, color=1)], title="Point-to-plane residual", y_label="RMS [mm]", floor=0.0
        ),
        line_chart(
            scans.seconds, [Line(y=matched, color=3)], title="Points that found a plane", y_label="share [%]",
            limits=(0.0, 105.0), spans=verdict_spans(scans),
        ),
    ]  # fmt: skip


def timings(record: RunRecord) -> str:
    """Return bars of the odometry's stages: median, and the 95th percentile as a whisker."""
    stages = {name: ms for name, ms in record.scans.stages.items() if len(ms)}
    if not stages:
        return ""
    rows = [(name, float(np.median(ms)), float(np.percentile(ms, 95))) for name, ms in stages.items()]
    total = np.sum(list(stages.values()), axis=0)
    rows.append(("all stages", float(np.median(total)), float(np.percentile(total, 95))))
    width, step, left = 560, 22, 118
    height = step * len(rows) + 44
    axis = Axis(low=0.0, high=max(row[2] for row in rows) * 1.12 + 1e-9, start=left, end=width - 64)
    parts = [f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="Time by stage">']
    for tick in axis.ticks(5):
        x = float(axis(tick))
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="4" y2="{height - 36}"/>')
        parts.append(text(x, height - 21, number(tick)))
    for i, (name, median, high) in enumerate(rows):
        y = 8 + i * step
        color = 2 if name == "all stages" else 1
        start, middle, end = (float(axis(v)) for v in (0.0, median, high))
        parts.append(text(left - 8, y + 11, name.replace("_", " "), anchor="end"))
        parts.append(
            f'<rect class="bar b{color}" x="{start:.1f}" y="{y}" width="{middle - start:.1f}" height="14" rx="2"/>'
        )
        parts.append(f'<path class="whisker" d="M{middle:.1f} {y + 7}H{end:.1f}M{end:.1f} {y + 3}V{y + 11}"/>')
        parts.append(text(end + 6, y + 11, f"{median:.2f}", anchor="start"))
    parts.append(
        text(
            (left + width - 64) / 2,
            height - 5,
            "milliseconds a scan: median, whisker to the 95th percentile",
            kind="label",
        )
    )
    return f'<figure class="panel"><figcaption><b>Time by stage</b></figcaption>{"".join(parts)}</svg></figure>'


def trajectory(record: RunRecord, turned: bool) -> str:
    """Return the path from above, coloured by how well the weakest direction was observed.

    Parameters
    ----------
    record : RunRecord
        The run.
    turned : bool
        Draw x up and y left instead of x right and y up, as the map's picture does.
    """
    position = record.scans.triple("position")
    across, up = (-position[:, 1], position[:, 0]) if turned else (position[:, 0], position[:, 1])
    width, left, right, top, bottom = 1160, 58, 20, 16, 38
    span_x, span_y = max(np.ptp(across), 1.0) * 1.08, max(np.ptp(up), 1.0) * 1.12
    scale = min((width - left - right) / span_x, 520.0 / span_y)
    height = int(max(span_y * scale, 120.0)) + top + bottom
    plot_w, plot_h = (width - left - right) / scale, (height - top - bottom) / scale
    x_axis = centre_axis(across, plot_w, left, width - right)
    y_axis = centre_axis(up, plot_h, height - bottom, top)
    seen = np.nan_to_num(record.scans.triple("eigenvalue_translation")[:, 0])
    numbers = hover_attributes(
        ("time [s]", "x [m]", "y [m]", "z [m]", "weakest eigenvalue"),
        (x_axis(across), y_axis(up), record.scans.seconds, *position.T, seen),
    )
    parts = [
        f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="Trajectory from above" {numbers}>'
    ]
    parts += equal_grid(x_axis, y_axis, ("−y [m]", "x [m]") if turned else ("x [m]", "y [m]"), height, bottom, left)
    parts += _colored_path(x_axis(across), y_axis(up), _observability(record.scans))
    parts += marker(float(x_axis(across[0])), float(y_axis(up[0])), "start")
    ends = np.array([x_axis(across[[0, -1]]), y_axis(up[[0, -1]])])
    end = marker(float(ends[0, 1]), float(ends[1, 1]), "end")
    # Where a lap is closed, the two names would lie on each other: the ring says that it ends there.
    parts += end if float(np.hypot(*(ends[:, 1] - ends[:, 0]))) > _NAMES_APART else end[:1]
    scale_bar = (
        f'<span class="ramp">unobservable<i style="background:{css_gradient(OBSERVABILITY)}"></i>well seen</span>'
    )
    caption = f"<b>Trajectory from above</b><span class='key'>coloured by the weakest direction</span>{scale_bar}"
    return f'<figure class="panel wide"><figcaption>{caption}</figcaption>{"".join(parts)}</svg></figure>'


def centre_axis(values: NDArray[np.float64], length: float, start: float, end: float) -> Axis:
    """Return an axis of a length [m] about the middle of values."""
    middle = 0.5 * (float(values.min()) + float(values.max()))
    return Axis(low=middle - length / 2, high=middle + length / 2, start=start, end=end)


def equal_grid(x_axis: Axis, y_axis: Axis, labels: tuple[str, str], height: int, bottom: int, left: int) -> list[str]:
    """Return the grid of a picture that has one scale for both axes, with ticks and the axes' names."""
    parts = []
    step_count = 8
    ticks = nice_ticks(x_axis.low, x_axis.high, step_count)
    step = ticks[1] - ticks[0] if len(ticks) > 1 else 1.0
    y_ticks = [i * step for i in range(int(np.ceil(y_axis.low / step)), int(np.floor(y_axis.high / step)) + 1)]
    for tick in ticks:
        x = float(x_axis(tick))
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{y_axis.end:.0f}" y2="{height - bottom}"/>')
        parts.append(text(x, height - bottom + 15, number(round(tick, 9))))
    for tick in y_ticks:
        y = float(y_axis(tick))
        parts.append(f'<line class="grid" x1="{x_axis.start:.0f}" x2="{x_axis.end:.0f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(text(left - 6, y + 3.5, number(round(tick, 9)), anchor="end"))
    parts.append(text((x_axis.start + x_axis.end) / 2, height - 5, labels[0], kind="label"))
    parts.append(text(13, (y_axis.start + y_axis.end) / 2, labels[1], kind="label", rotate=True))
    return parts


def _observability(scans: ScanTable) -> NDArray[np.int64]:
    """Return each scan's place on the seven-step scale: the weakest eigenvalue on a logarithmic scale up to even."""
    weakest = np.maximum(scans.triple("eigenvalue_translation")[:, 0], _MIN_SHOWN_SHARE)
    share = np.log(weakest / _MIN_SHOWN_SHARE) / np.log(_EVEN_SHARE / _MIN_SHOWN_SHARE)
    step = np.clip(share * len(OBSERVABILITY), 0, len(OBSERVABILITY) - 1).astype(np.int64)
    untracked = np.array([status in ("degenerate", "predicted", "lost", "empty") for status in scans.statuses])
    return np.where(untracked, 0, step)


def _colored_path(x: NDArray[np.float64], y: NDArray[np.float64], step: NDArray[np.int64]) -> list[str]:
    keep = _find_moves(x, y)
    x, y, step = x[keep], y[keep], step[keep]
    parts = []
    for name, first, last in _runs([str(s) for s in step]):
        stop = min(last + 2, len(x))  # reach to the next stretch's first point
        color = OBSERVABILITY[int(name)]
        parts.append(polyline(x[first:stop], y[first:stop], f'class="path" stroke="{color}"'))
    return parts


def _find_moves(x: NDArray[np.float64], y: NDArray[np.float64], least: float = 0.7) -> NDArray[np.bool_]:
    """Return which pixels lie far enough from the last kept one to be worth drawing; the ends always are."""
    keep = np.zeros(len(x), dtype=bool)
    last = (np.inf, np.inf)
    for i, (px, py) in enumerate(zip(x.tolist(), y.tolist(), strict=True)):
        if i in (0, len(x) - 1) or abs(px - last[0]) + abs(py - last[1]) > least:
            keep[i], last = True, (px, py)
    return keep


def marker(x: float, y: float, name: str) -> list[str]:
    """Return a named dot: filled at the start, a ring at the end."""
    if name == "start":
        return [
            f'<circle class="start" cx="{x:.1f}" cy="{y:.1f}" r="5"/>',
            text(x + 9, y - 7, name, kind="mark", anchor="start"),
        ]
    return [
        f'<circle class="end" cx="{x:.1f}" cy="{y:.1f}" r="8"/>',
        text(x + 9, y + 17, name, kind="mark", anchor="start"),
    ]
