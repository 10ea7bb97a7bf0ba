"""The map's pictures: from above and from the side, by height and by intensity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from heliograph.output.record import RunRecord
from heliograph.report.charts import marker
from heliograph.report.colors import HEIGHT, INTENSITY, css_gradient
from heliograph.report.png import data_uri, encode_png
from heliograph.report.raster import Raster, View, color_image, render, side_view, top_view
from heliograph.report.svg import number, polyline, round_length, text

__all__ = ["MapPictures"]

_ROOF_CELL = 0.5  # [m]
_ROOF_LEVEL = 0.5  # [m]
_ROOF_SHARE = 0.08  # of the occupied cells
_ROOF_CLEARANCE = 1.0  # above the sensor [m]
_MAX_POINTS = 6_000_000


@dataclass(frozen=True)
class MapPictures:
    """Renders a run's map once for each view, whoever asks for it.

    Parameters
    ----------
    record : RunRecord
        A run with at least one map point.
    """

    record: RunRecord

    @cached_property
    def points(self) -> NDArray[np.float32]:
        """Points to draw: all, or an even selection of very many."""
        return self.record.points_map[:: self._stride]

    @cached_property
    def intensity(self) -> NDArray[np.float32] | None:
        """Their intensity; None where it says nothing."""
        values = self.record.intensity
        if values is None or not len(values) or float(np.ptp(values)) == 0.0:
            return None
        return values[:: self._stride]

    @property
    def _stride(self) -> int:
        return max(len(self.record.points_map) // _MAX_POINTS, 1)

    @cached_property
    def path(self) -> NDArray[np.float64]:
        """Positions of the run [m]."""
        return self.record.scans.triple("position")

    @cached_property
    def top(self) -> View:
        """The view from above."""
        return top_view(self.points, self.path)

    @cached_property
    def side(self) -> View:
        """The view from the side."""
        return side_view(self.points, self.path, self.top)

    @cached_property
    def ceiling(self) -> float | None:
        """Height above which points hide the way from above, if most of it lies under a roof [m]."""
        # A roof is one level that tops a good part of all occupied cells; trees and facades end at all heights.
        keys = np.floor((self.points[:, :2] - self.points[:, :2].min(axis=0)) / _ROOF_CELL).astype(np.int64)
        span = keys.max(axis=0) + 1
        if int(span[0]) * int(span[1]) > _MAX_POINTS:
            return None
        top = np.full(int(span.prod()), -np.inf, dtype=np.float32)
        np.maximum.at(top, keys[:, 0] * span[1] + keys[:, 1], self.points[:, 2])
        top = top[np.isfinite(top)]
        floor = float(np.percentile(self.path[:, 2], 95)) + _ROOF_CLEARANCE
        levels, counts = np.unique(np.floor((top[top > floor] - floor) / _ROOF_LEVEL), return_counts=True)
        roofs = levels[counts > _ROOF_SHARE * len(top)]
        return floor + float(roofs[0]) * _ROOF_LEVEL - _ROOF_LEVEL if len(roofs) else None

    @cached_property
    def top_raster(self) -> Raster:
        """Which point each pixel from above shows."""
        if self.ceiling is None:
            return render(self.points, self.top, point_size=self._spacing)
        below = np.flatnonzero(self.points[:, 2] <= self.ceiling).astype(np.int32)
        if len(below) == 0:  # a roof is all that there is: it hides nothing
            return render(self.points, self.top, point_size=self._spacing)
        raster = render(self.points[below], self.top, point_size=self._spacing)
        nearest = np.where(raster.nearest >= 0, below[raster.nearest], np.int32(-1))
        return Raster(nearest=nearest, shade=raster.shade)

    @cached_property
    def side_raster(self) -> Raster:
        """Which point each pixel from the side shows."""
        return render(self.points, self.side, point_size=self._spacing)

    @property
    def _spacing(self) -> float:
        return 0.12

    @cached_property
    def height_limits(self) -> tuple[float, float]:
        """Ends of the height scale [m]: what is seen from above, without the outlying hundredth."""
        visible = self.top_raster.nearest[self.top_raster.nearest >= 0]
        low, high = np.percentile(self.points[visible, 2], [1.0, 99.0]) if len(visible) else (0.0, 1.0)
        return float(low), float(max(high, low + 0.1))

    @cached_property
    def intensity_limits(self) -> tuple[float, float]:
        """Ends of the intensity scale, in the sensor's unit."""
        if self.intensity is None:
            return 0.0, 1.0
        low, high = np.percentile(self.intensity[:: max(len(self.intensity) // 200_000, 1)], [2.0, 98.0])
        return float(low), float(max(high, low + 1e-6))

    def image(self, raster: Raster, by: str) -> NDArray[np.uint8]:
        """Return a picture coloured by ``"height"`` or ``"intensity"``."""
        if by == "intensity" and self.intensity is not None:
            return color_image(raster, self.intensity, INTENSITY, self.intensity_limits)
        return color_image(raster, self.points[:, 2], HEIGHT, self.height_limits)

    def _encode(self, view: str, by: str) -> bytes:
        cache: dict[tuple[str, str], bytes] = self.__dict__.setdefault("_pngs", {})
        if (view, by) not in cache:
            raster = self.top_raster if view == "top" else self.side_raster
            cache[view, by] = encode_png(self.image(raster, by))
        return cache[view, by]

    def html(self) -> str:
        """Return the map section: both views, with tabs for the two colourings where there is intensity."""
        kinds = ["height"] + (["intensity"] if self.intensity is not None else [])
        tabs = "".join(
            f'<input type="radio" name="by" id="by-{by}"{" checked" if by == "height" else ""}>' for by in kinds
        )
        labels = "".join(f'<label for="by-{by}">{by}</label>' for by in kinds) if len(kinds) > 1 else ""
        bodies = "".join(self._views(by) for by in kinds)
        note = ""
        if self.ceiling is not None:
            note = f" From above, what lies higher than {self.ceiling:.1f} m is left out: it would hide the way."
        count = f"{self.record.map_points:,}".replace(",", " ")
        if self.record.moving_points:
            note += (
                f" {_cubes(self.record.moving_points)} left out: other scans saw through them, as what was there moved."
            )
        return (
            f'<section class="map">{tabs}<div class="tabs">{labels}</div>{bodies}'
            f'<p class="note">{count} points, {self.top.pixel:.3f} m a pixel; the line is the trajectory.{note}</p>'
            "</section>"
        )

    def _views(self, by: str) -> str:
        limits, colors, unit = (
            (self.height_limits, HEIGHT, "m") if by == "height" else (self.intensity_limits, INTENSITY, "")
        )
        ramp = (
            f'<div class="ramp">{by} <span>{number(float(f"{limits[0]:.3g}"))} {unit}</span>'
            f'<i style="background:{css_gradient(colors)}"></i>'
            f"<span>{number(float(f'{limits[1]:.3g}'))} {unit}</span></div>"
        )
        return (
            f'<div class="views {by}">{self._figure("top", by, "from above", ramp)}'
            f"{self._figure('side', by, 'from the side', '')}</div>"
        )

    def _figure(self, name: str, by: str, title: str, ramp: str) -> str:
        view = self.top if name == "top" else self.side
        rows, columns = view.shape
        source = data_uri(self._encode(name, by))
        overlay = "".join(self._overlay(view))
        return (
            f'<figure class="shot"><figcaption>{title}{ramp}</figcaption>'
            f'<img src="{source}" width="{columns}" height="{rows}" '
            f'alt="The map {title}, coloured by {by}"><svg viewBox="0 0 {columns} {rows}">{overlay}</svg>'
            "</figure>"
        )

    def _overlay(self, view: View) -> list[str]:
        rows, columns = view.shape
        size = columns / 1160.0  # the page shows the picture 1160 wide: keep words at their size
        across = view.to_pixels(self.path)
        parts = [polyline(across[:, 0], across[:, 1], f'class="way" stroke-width="{1.6 * size:.2f}"')]
        scaled = "".join((*marker(0.0, 0.0, "start"),))
        x, y = across[0]
        parts.append(f'<g transform="translate({x:.1f} {y:.1f}) scale({size:.3f})">{scaled}</g>')
        length = round_length(columns * view.pixel / 5.0)
        wide = length / view.pixel / size
        bar = f'<path class="scale" d="M0 -4V4M0 0H{wide:.1f}M{wide:.1f} -4V4"/>' + text(
            wide / 2, -8, f"{number(length)} m", kind="mark"
        )
        # From above the lower corners are mostly free; from the side the sky is.
        from_side = view.labels[1] == "z"
        base = 46 * size if from_side else rows - 20 * size
        right = columns - (wide + 22) * size
        left = right - 90 * size if from_side else 24 * size
        parts.append(f'<g transform="translate({right:.1f} {base:.1f}) scale({size:.3f})">{bar}</g>')
        arrows = (
            '<path class="scale" d="M0 0H30M25 -4L30 0L25 4M0 0V-30M-4 -25L0 -30L4 -25"/>'
            + text(36, 4, view.labels[0], kind="mark", anchor="start")
            + text(0, -36, view.labels[1], kind="mark")
        )
        parts.append(f'<g transform="translate({left:.1f} {base:.1f}) scale({size:.3f})">{arrows}</g>')
        return parts


def _cubes(count: int) -> str:
    return "one cube is" if count == 1 else f"{count:,} cubes are".replace(",", " ")
