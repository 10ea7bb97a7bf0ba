"""A chart on two logarithmic axes as a file of its own: curves, bands, and guides of a known slope."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.report.svg import Axis, polyline, text

__all__ = ["Curve", "Guide", "loglog_svg"]


_WIDTH, _HEIGHT = 860, 560
_LEFT, _RIGHT, _TOP, _BOTTOM = 78, 24, 96, 56
_LETTER_WIDTH = 7.3  # usual width of a bold letter of a guide's name
_STYLE = """
svg{color-scheme:light dark;--bg:#fff;--ink:#18202b;--soft:#5b6675;--line:#c6ccd5;--grid:#e9ecf0;--fine:#f4f5f8;
--c1:#2f6fd0;--c2:#1f9d8a;--c3:#c77a12;font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans",sans-serif;
font-variant-numeric:tabular-nums}
@media(prefers-color-scheme:dark){svg{--bg:#171e27;--ink:#e6ebf1;--soft:#98a4b3;--line:#3a4656;--grid:#2a3440;
--fine:#1f2731;--c1:#6ea8ff;--c2:#46c9b4;--c3:#f0b04e}}
.ground{fill:var(--bg)}.grid{stroke:var(--grid)}.fine{stroke:var(--fine)}.axis{stroke:var(--line)}
.title{fill:var(--ink);font-size:17px;font-weight:650}.note,.tick{fill:var(--soft);font-size:12px}
.label{fill:var(--soft);font-size:13px}.key{fill:var(--ink);font-size:13px}
.line{fill:none;stroke-width:1.8;stroke-linejoin:round}.fit{fill:none;stroke-width:1.3;stroke-dasharray:5 4}
.band{opacity:.17}.c1{stroke:var(--c1)}.c2{stroke:var(--c2)}.c3{stroke:var(--c3)}
.b1{fill:var(--c1)}.b2{fill:var(--c2)}.b3{fill:var(--c3)}
.guide{stroke:var(--soft);stroke-width:1;stroke-dasharray:1.5 3.5;fill:none}
.name{fill:var(--ink);font-size:12.5px;font-weight:600;paint-order:stroke;stroke:var(--bg);stroke-width:4px}
.dot{fill:var(--bg);stroke:var(--ink);stroke-width:1.4}
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """One curve with its band.

    Parameters
    ----------
    x, y : (n,) float64
        Positive.
    color : int
        1 to 3.
    label : str
        In the legend; empty leaves it out.
    low, high : (n,) float64, optional
        Edges of the band.
    dashed : bool
        As a fit is drawn.
    """

    x: Array
    y: Array
    color: int
    label: str = ""
    low: Array | None = None
    high: Array | None = None
    dashed: bool = False

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Guide:
    """A straight line of a power law through a marked point, cut where the curves end.

    Parameters
    ----------
    x, y : float
        The point.
    slope : float
        On the logarithmic axes.
    name : str
        Written beside the point.
    below : bool
        Write it below even where the line falls, because the curves are above.
    """

    x: float
    y: float
    slope: float
    name: str
    below: bool = False


def loglog_svg(
    curves: Sequence[Curve],
    guides: Sequence[Guide] = (),
    *,
    title: str,
    note: str,
    x_label: str,
    y_label: str,
) -> str:
    """Return the chart as a whole SVG document in light or dark colours, as the viewer prefers.

    Parameters
    ----------
    curves : sequence of Curve
        At least one.
    guides : sequence of Guide
    title, note : str
        First and second line.
    x_label, y_label : str
        With units.
    """
    x_axis, y_axis = _axes(curves, guides)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" '
        f'height="{_HEIGHT}" role="img" aria-label="{escape(title)}"><style>{_STYLE}</style>'
        f'<rect class="ground" width="{_WIDTH}" height="{_HEIGHT}"/>',
        text(_LEFT, 30, title, kind="title", anchor="start"),
        text(_LEFT, 51, note, kind="note", anchor="start"),
        *_legend(curves),
        *_grid(x_axis, y_axis, x_label, y_label),
        f'<clipPath id="plot"><rect x="{_LEFT}" y="{_TOP}" width="{_WIDTH - _LEFT - _RIGHT}" '
        f'height="{_HEIGHT - _TOP - _BOTTOM}"/></clipPath><g clip-path="url(#plot)">',
        *(_line_of(guide, x_axis, y_axis) for guide in guides),
        *(part for curve in curves for part in _curve(curve, x_axis, y_axis)),
        "</g>",
        *(part for guide in guides for part in _name_of(guide, x_axis, y_axis)),
        "</svg>\n",
    ]
    return "".join(parts)


def _axes(curves: Sequence[Curve], guides: Sequence[Guide]) -> tuple[Axis, Axis]:
    """Return axes that hold all points with some air; bands may be cut."""
    x = np.concatenate([curve.x for curve in curves])
    y = np.concatenate([*(curve.y for curve in curves), np.array([guide.y for guide in guides])])
    y = y[np.isfinite(y) & (y > 0.0)]
    if not len(y):
        y = np.array([1.0])
    x_low, x_high = float(x.min()) / 1.15, float(x.max()) * 1.15
    y_low, y_high = float(y.min()) / 1.7, float(y.max()) * 1.5
    return (
        Axis(low=x_low, high=x_high, start=_LEFT, end=_WIDTH - _RIGHT, log=True),
        Axis(low=y_low, high=y_high, start=_HEIGHT - _BOTTOM, end=_TOP, log=True),
    )


def _decades(axis: Axis) -> list[int]:
    return list(range(math.floor(math.log10(axis.low)), math.ceil(math.log10(axis.high)) + 1))


def _grid(x_axis: Axis, y_axis: Axis, x_label: str, y_label: str) -> list[str]:
    parts = []
    top, base, left, right = _TOP, _HEIGHT - _BOTTOM, _LEFT, _WIDTH - _RIGHT
    for axis, across in ((x_axis, True), (y_axis, False)):
        few = len([d for d in _decades(axis) if axis.low <= 10.0**d <= axis.high]) < 3
        for decade in _decades(axis):
            for multiple in range(1, 10):
                value = multiple * 10.0**decade
                if not axis.low <= value <= axis.high:
                    continue
                at = float(axis(value))
                kind = "grid" if multiple == 1 else "fine"
                ends = f'x1="{at:.1f}" x2="{at:.1f}" y1="{top}" y2="{base}"'
                if not across:
                    ends = f'x1="{left}" x2="{right}" y1="{at:.1f}" y2="{at:.1f}"'
                parts.append(f'<line class="{kind}" {ends}/>')
                if multiple == 1 or (few and multiple in (2, 5)):
                    where = (at, base + 18.0) if across else (left - 8.0, at + 4.0)
                    parts.append(text(*where, _short(value), anchor="middle" if across else "end"))
    parts.append(f'<path class="axis" fill="none" d="M{left} {top}V{base}H{right}"/>')
    parts.append(text((left + right) / 2, _HEIGHT - 14, x_label, kind="label"))
    parts.append(text(20, (top + base) / 2, y_label, kind="label", rotate=True))
    return parts


def _short(value: float) -> str:
    """Return a tick's label: plain from 0.01 to 10000, else as 2e-5 with a real minus."""
    if 0.009 < value < 20_000.0:
        return f"{value:.5g}"
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}".replace("-", "−")


def _curve(curve: Curve, x_axis: Axis, y_axis: Axis) -> list[str]:
    parts = []
    x = x_axis(curve.x)
    if curve.low is not None and curve.high is not None:
        edge = np.concatenate([x, x[::-1]])
        sides = np.concatenate([y_axis(curve.high), y_axis(curve.low)[::-1]])
        parts.append(polyline(edge, sides, f'class="band b{curve.color}"'))
    y = np.where(curve.y > 0.0, y_axis(curve.y), np.nan)
    parts.append(polyline(x, y, f'class="{"fit" if curve.dashed else "line"} c{curve.color}"'))
    return parts


def _legend(curves: Sequence[Curve]) -> list[str]:
    parts, x = [], float(_LEFT)
    for curve in curves:
        if not curve.label:
            continue
        kind = "fit" if curve.dashed else "line"
        parts.append(f'<path class="{kind} c{curve.color}" d="M{x:.1f} 74H{x + 22:.1f}"/>')
        parts.append(text(x + 28, 78.5, curve.label, kind="key", anchor="start"))
        x += 52.0 + 6.7 * len(curve.label)
    return parts


def _line_of(guide: Guide, x_axis: Axis, y_axis: Axis) -> str:
    """Return the guide's line over the decade and a half on either side of its point."""
    x = np.array([max(guide.x / 30.0, x_axis.low), min(guide.x * 30.0, x_axis.high)])
    y = guide.y * (x / guide.x) ** guide.slope
    px, py = (
        x_axis(x),
        y_axis.start + (y_axis.end - y_axis.start) * (np.log(y / y_axis.low) / math.log(y_axis.high / y_axis.low)),
    )
    return polyline(px, py, 'class="guide"')


def _name_of(guide: Guide, x_axis: Axis, y_axis: Axis) -> list[str]:
    if not x_axis.low <= guide.x <= x_axis.high:
        return []
    x, y = float(x_axis(guide.x)), float(y_axis(guide.y))
    # A falling curve leaves the side above its point free, to the right; a level or rising one that below.
    falling = guide.slope < 0.0 and not guide.below
    anchor = "end" if x + 12.0 + _LETTER_WIDTH * len(guide.name) > _WIDTH - 6.0 else "start"
    dx = -12.0 if anchor == "end" else 12.0
    above = -10.0 if falling and anchor == "start" else 20.0
    return [
        f'<circle class="dot" cx="{x:.1f}" cy="{y:.1f}" r="4"/>',
        text(x + dx, min(y + above, _HEIGHT - _BOTTOM - 6.0), guide.name, kind="name", anchor=anchor),
    ]
