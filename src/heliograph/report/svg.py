"""Charts as SVG text: crisp at any size, small, and in the page's own light or dark colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.report.hover import hover_attributes

__all__ = ["Axis", "Line", "Span", "line_chart", "nice_ticks", "number", "polyline", "round_length", "text"]

_MAX_DOTS = 500  # of values that stand alone
_LEFT, _RIGHT, _TOP, _BOTTOM = 74, 14, 12, 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One curve: values, a colour number (1 to 6), a name, and optionally half the height of a band around it."""

    y: NDArray[np.float64]
    color: int = 1
    label: str = ""
    sigma: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Span:
    """A stretch of the x axis to mark with a class of the style sheet."""

    low: float
    high: float
    kind: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """Maps values to pixels, linearly or by logarithm."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, values: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return pixel coordinates."""
        values = np.asarray(values, dtype=np.float64)
        if self.log:
            ratio = np.log(np.maximum(values, self.low) / self.low) / math.log(self.high / self.low)
        else:
            ratio = (values - self.low) / (self.high - self.low)
        return self.start + ratio * (self.end - self.start)

    def ticks(self, count: int) -> list[float]:
        """Return round values inside the axis."""
        if self.log:
            first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
            decades = [10.0**power for power in range(first, last + 1)]
            # Two decades or fewer would leave the axis nearly bare.
            between = [m * d for d in (self.low, *decades) for m in (2.0, 5.0) if self.low < m * d < self.high]
            return decades if len(decades) > 3 else sorted({*decades, *(round(v, 12) for v in between)})
        return nice_ticks(self.low, self.high, count)


def nice_ticks(low: float, high: float, count: int) -> list[float]:
    """Return about ``count`` multiples of 1, 2 or 5 times a power of ten in [low, high]."""
    if not high > low:
        return [low]
    raw = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(multiple * power for multiple in (1.0, 2.0, 5.0, 10.0) if multiple * power >= 0.75 * raw)
    first = math.ceil(low / step - 1e-9)
    return [round(i * step, 12) for i in range(first, math.floor(high / step + 1e-9) + 1)]


def round_length(limit: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not above ``limit``."""
    power = 10.0 ** math.floor(math.log10(limit))
    return next(multiple * power for multiple in (5.0, 2.0, 1.0) if multiple * power <= limit * (1.0 + 1e-9))


def number(value: float) -> str:
    """Return a tick's label: at most four significant digits, no exponent from 1e-4 to 1e5."""
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.6g}".replace("-", "−")
    return f"{value:.0e}".replace("e-0", "e−").replace("e+0", "e").replace("-", "−")


def text(x: float, y: float, content: str, *, kind: str = "tick", anchor: str = "middle", rotate: bool = False) -> str:
    """Return a text element."""
    turn = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if rotate else ""
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{turn}>{escape(content)}</text>'


def polyline(x: NDArray[np.float64], y: NDArray[np.float64], attributes: str) -> str:
    """Return a path through pixel coordinates, broken where one is not finite."""
    parts, pen = [], "M"
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        if math.isfinite(px) and math.isfinite(py):
            parts.append(f"{pen}{px:.1f} {py:.1f}")
            pen = "L"
        else:
            pen = "M"
    return f'<path {attributes} d="{"".join(parts)}"/>' if parts else ""


def thin(
    x: NDArray[np.float64], y: NDArray[np.float64], columns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return at most two points a pixel column, its lowest and its highest, so that no peak gets lost."""
    if len(x) <= 2 * columns:
        return x, y
    size = math.ceil(len(x) / columns)
    padded = np.full(size * columns, np.nan)
    padded[: len(y)] = y
    blocks = padded.reshape(columns, size)
    blocks = blocks[np.isfinite(blocks).any(axis=1)]
    offsets = np.arange(len(blocks)) * size
    ends = np.stack([np.nanargmin(blocks, axis=1), np.nanargmax(blocks, axis=1)], axis=1)
    picks = np.unique((offsets[:, None] + np.sort(ends, axis=1)).ravel())
    return x[picks], y[picks]


def line_chart(
    x: NDArray[np.float64],
    lines: Sequence[Line],
    *,
    title: str,
    y_label: str,
    x_label: str = "time [s]",
    width: int = 560,
    height: int = 210,
    log: bool = False,
    floor: float | None = None,
    limits: tuple[float, float] | None = None,
    spans: Sequence[Span] = (),
) -> str:
    """Return a chart of curves over a common x, with title, legend, ticks and units.

    Parameters
    ----------
    x : (N,) float64
        Common abscissa.
    lines : sequence of Line
        The curves.
    title, y_label, x_label : str
        Words, with units.
    width, height : int
        Size in pixels; the page scales it.
    log : bool
        Logarithmic ordinate.
    floor : float, optional
        A value that the ordinate must reach down to, such as 0.
    limits : tuple of float, optional
        Ordinate's range; by default it is chosen so that outliers do not squeeze the rest.
    spans : sequence of Span
        Stretches to mark.
    """
    low, high = limits or y_limits(lines, log=log, floor=floor)
    x_low, x_high = (float(x[0]), float(x[-1])) if len(x) else (0.0, 1.0)
    x_axis = Axis(low=x_low, high=max(x_high, x_low + 1e-9), start=_LEFT, end=width - _RIGHT)
    y_axis = Axis(low=low, high=high, start=height - _BOTTOM, end=_TOP, log=log)
    numbers = _hover(x, lines, x_axis, x_label, y_label, (_TOP, height - _BOTTOM))
    parts = [f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}" {numbers}>']
    parts += _frame(x_axis, y_axis, x_label, y_label, width, height)
    for span in spans:
        left, right = float(x_axis(span.low)), float(x_axis(span.high))
        parts.append(
            f'<rect class="span {span.kind}" x="{left:.1f}" y="{_TOP}" width="{max(right - left, 1.5):.1f}" '
            f'height="{height - _BOTTOM - _TOP}"/>'
        )
    for line in lines:
        parts += _curve(x, line, x_axis, y_axis)
    parts.append("</svg>")
    return (
        f'<figure class="panel"><figcaption><b>{escape(title)}</b>{legend(lines)}</figcaption>{"".join(parts)}</figure>'
    )


def _hover(
    x: NDArray[np.float64], lines: Sequence[Line], x_axis: Axis, x_label: str, y_label: str, plot: tuple[int, int]
) -> str:
    """Return the chart's numbers for the pointer: the abscissa, and of each curve its value, with its sigma if any."""
    unit = y_label[y_label.find("[") :] if "[" in y_label else ""
    names, columns = [x_label], [x]
    for line in lines:
        names.append(
            f"{line.label or y_label.partition(' [')[0]} {unit}".strip() + ("±" if line.sigma is not None else "")
        )
        columns += [line.y] if line.sigma is None else [line.y, line.sigma]
    return hover_attributes(names, columns, (x_axis.low, x_axis.high, x_axis.start, x_axis.end, *plot))


def legend(lines: Sequence[Line]) -> str:
    """Return the names of the curves with their colours."""
    return "".join(
        f'<span class="key"><i class="b{line.color}"></i>{escape(line.label)}</span>' for line in lines if line.label
    )


def y_limits(lines: Sequence[Line], *, log: bool, floor: float | None) -> tuple[float, float]:
    """Return a range that shows the inner 99.8 % of the values with some air."""
    stacked = []
    for line in lines:
        # A wide band at the start, before anything is known, must not flatten the rest.
        reach = 0.0 if line.sigma is None else np.minimum(line.sigma, 3.0 * np.nanmedian(line.sigma))
        stacked += [line.y - reach, line.y + reach]
    values = np.concatenate(stacked) if stacked else np.zeros(0)
    values = values[np.isfinite(values) & ((values > 0) | (not log))]
    if not len(values):
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = (float(v) for v in np.percentile(values, [0.1, 99.9]))
    if log:
        return 10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high * 1.001))
    if floor is not None:
        low = min(low, floor)
    air = max(0.06 * (high - low), 1e-6 * max(abs(low), abs(high)), 1e-9)
    return (low if low == floor else low - air), high + air


def _frame(x_axis: Axis, y_axis: Axis, x_label: str, y_label: str, width: int, height: int) -> list[str]:
    parts = []
    for tick in y_axis.ticks(4):
        y = float(y_axis(tick))
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(text(_LEFT - 6, y + 3.5, number(tick), anchor="end"))
    for tick in x_axis.ticks(6):
        x = float(x_axis(tick))
        parts.append(
            f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="{height - _BOTTOM}" y2="{height - _BOTTOM + 4}"/>'
        )
        parts.append(text(x, height - _BOTTOM + 15, number(tick)))
    base = height - _BOTTOM
    parts.append(f'<line class="axis" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{base}" y2="{base}"/>')
    parts.append(text((_LEFT + width - _RIGHT) / 2, height - 5, x_label, kind="label"))
    parts.append(text(13, (base + _TOP) / 2, y_label, kind="label", rotate=True))
    return parts


def _curve(x: NDArray[np.float64], line: Line, x_axis: Axis, y_axis: Axis) -> list[str]:
    columns = int(abs(x_axis.end - x_axis.start))
    clip = (min(y_axis.start, y_axis.end), max(y_axis.start, y_axis.end))
    parts = []
    if line.sigma is not None:
        every = slice(None, None, max(len(x) // columns, 1))
        upper = np.clip(y_axis(line.y + line.sigma), *clip)[every]
        lower = np.clip(y_axis(line.y - line.sigma), *clip)[every]
        across = x_axis(x)[every]
        known = np.isfinite(upper) & np.isfinite(lower)
        edge = np.concatenate([across[known], across[known][::-1]])
        parts.append(polyline(edge, np.concatenate([upper[known], lower[known][::-1]]), f'class="band b{line.color}"'))
    thin_x, thin_y = thin(x, line.y, columns)
    drawn_x, drawn_y = x_axis(thin_x), np.clip(y_axis(thin_y), *clip)
    parts.append(polyline(drawn_x, drawn_y, f'class="line c{line.color}"'))
    # A value between two that are none makes no line.
    known = np.concatenate([[False], np.isfinite(drawn_y), [False]])
    for i in np.flatnonzero(known[1:-1] & ~known[:-2] & ~known[2:])[:_MAX_DOTS]:
        parts.append(f'<circle class="b{line.color}" cx="{drawn_x[i]:.1f}" cy="{drawn_y[i]:.1f}" r="2.5"/>')
    return parts
