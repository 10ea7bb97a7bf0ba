"""Pictures of a cloud: orthographic, nearest point first, shaded by depth.

The shading is eye-dome lighting (C. Boucheny, Interactive scientific visualization of large datasets,
PhD thesis, Grenoble 2009): a pixel darkens by how far its neighbours stand in front of it, which shows edges
without normals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.report.colors import GROUND, scale

__all__ = ["Raster", "View", "color_image", "extent", "render", "side_view", "top_view"]

_T = TypeVar("_T", bound=np.generic)
_MAX_WIDTH, _MAX_HEIGHT = 1440, 900
_MIN_SIDE_HEIGHT = 0.12  # of the width
_MAX_GROWTH = 6
_MIN_REACH, _REACH_SHARE = 25.0, 0.5  # beyond the path: metres, and share of the path's longer side
_SHADE_STRENGTH = 0.9
_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A window onto the map.

    Parameters
    ----------
    axes : (3, 3) float64
        Rows: the map directions that run right, up, and towards the viewer.
    low, high : tuple of float
        Extent along right and up [m].
    pixel : float
        Edge of a pixel [m].
    labels : tuple of str
        Names of the right and up axes, with the sign that they run in.
    """

    axes: NDArray[np.float64]
    low: tuple[float, float]
    high: tuple[float, float]
    pixel: float
    labels: tuple[str, str]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        rows, columns = ((self.high[i] - self.low[i]) / self.pixel for i in (1, 0))
        return max(int(np.ceil(rows)), 1), max(int(np.ceil(columns)), 1)

    def to_pixels(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return (N, 2) column and row coordinates of (N, 3) map points."""
        across = points @ self.axes[:2].T.astype(points.dtype)
        return np.stack([(across[:, 0] - self.low[0]) / self.pixel, (self.high[1] - across[:, 1]) / self.pixel], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Raster:
    """What each pixel shows.

    Parameters
    ----------
    nearest : (H, W) int32
        Index of the point in front, -1 where there is none.
    shade : (H, W) float32
        Brightness in (0, 1].
    """

    nearest: NDArray[np.int32]
    shade: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self)


def top_view(points: NDArray[np.float32], path: NDArray[np.float64], *, max_width: int = _MAX_WIDTH) -> View:
    """Return the view from above, its longer side lying, that holds the path and all but the outlying points."""
    low, high = extent(points, path)
    if high[0] - low[0] >= high[1] - low[1]:
        axes, labels = np.eye(3), ("x", "y")
    else:  # a quarter turn: x up, y left
        axes, labels = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), ("−y", "x")
    return _view(axes, labels, low, high, max_width, _MAX_HEIGHT)


def side_view(points: NDArray[np.float32], path: NDArray[np.float64], top: View) -> View:
    """Return the view from the side that lies under `top_view`'s: the same axis runs right, z up."""
    low, high = extent(points, path)
    right, up = top.axes[0], np.array([0.0, 0.0, 1.0])
    axes = np.stack([right, up, np.cross(right, up)])
    # Some sky over a wide flat scene: a strip of a few pixels shows nothing, and the names need room.
    high[2] = max(high[2], low[2] + _MIN_SIDE_HEIGHT * top.shape[1] * top.pixel)
    reach = 0.5 * _MAX_HEIGHT * top.pixel  # of a path that shot off into the sky a part must do
    middle = float(np.median(path[:, 2]))
    low[2], high[2] = max(low[2], middle - reach), min(high[2], middle + reach)
    return _view(axes, (top.labels[0], "z"), low, high, top.shape[1], _MAX_HEIGHT // 2, pixel=top.pixel)


def extent(points: NDArray[np.float32], path: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of a box around the path, and around the inner 99 % of the points as far as they are near it.

    What is seen through a door, far off, is left out: the picture is of where the path is.
    """
    first, last = path.min(axis=0), path.max(axis=0)
    reach = max(_MIN_REACH, _REACH_SHARE * float((last - first)[:2].max()))
    sample = points[:: max(len(points) // 200_000, 1)]
    near = ((sample[:, :2] >= first[:2] - reach) & (sample[:, :2] <= last[:2] + reach)).all(axis=1)
    low, high = np.percentile(sample[near] if near.any() else sample, [0.5, 99.5], axis=0)
    margin = np.array([1.0, 1.0, 0.3])
    return np.minimum(low, first) - margin, np.maximum(high, last) + margin


def _view(
    axes: NDArray[np.float64], labels: tuple[str, str], low: NDArray[np.float64], high: NDArray[np.float64],
    max_width: int, max_height: int, pixel: float = 0.0,
) -> View:  # fmt: skip
    corners = np.stack([low, high]) @ axes[:2].T
    low_uv, high_uv = corners.min(axis=0), corners.max(axis=0)
    size = high_uv - low_uv
    pixel = pixel or float(max(size[0] / max_width, size[1] / max_height))
    # Where the height is what limits the scale, the picture still fills the width: more of the surroundings.
    spare = max(max_width * pixel - size[0], 0.0) * np.array([0.5, 0.0])
    low_uv, high_uv = low_uv - spare, high_uv + spare
    return View(axes=axes, low=tuple(low_uv), high=tuple(high_uv), pixel=pixel, labels=labels)


def render(points: NDArray[np.float32], view: View, *, point_size: float = 0.1) -> Raster:
    """Find the point in front at every pixel.

    Parameters
    ----------
    points : (N, 3) float32
        The map [m].
    view : View
        From where.
    point_size : float
        Spacing of the points; each is drawn that large [m].
    """
    height, width = view.shape
    column, row = np.floor(view.to_pixels(points)).astype(np.int32).T
    inside = np.flatnonzero((column >= 0) & (column < width) & (row >= 0) & (row < height))
    depth = (points[inside] @ view.axes[2].astype(np.float32)).astype(np.float32)
    span = max(float(np.ptp(depth)), 1e-3) if len(depth) else 1.0
    # Sixteen bits of depth: NumPy sorts those by radix, and of two points within span / 65536 either will do.
    order = np.argsort(((depth - depth.min(initial=np.inf)) * (65535.0 / span)).astype(np.uint16), kind="stable")
    flat = (row[inside] * width + column[inside])[order]
    nearest = np.full(height * width, -1, dtype=np.int32)
    nearest[flat] = inside[order]  # of several values for one pixel the last stays: the one in front
    front = np.full(height * width, -np.inf, dtype=np.float32)
    front[flat] = depth[order]
    picture, before = nearest.reshape(height, width), front.reshape(height, width)
    for _ in range(min(round(point_size / (2.0 * view.pixel)), _MAX_GROWTH)):
        picture, before = _grow(picture, before)
    picture, before = _close_gaps(picture, before)
    return Raster(nearest=picture, shade=_shade(before))


def _shift(image: NDArray[_T], step: tuple[int, int], fill: float) -> NDArray[_T]:
    """Return the image of which pixel (r, c) is the given one's (r, c) + step."""
    moved = np.full_like(image, fill)
    height, width = image.shape
    (r, c) = step
    moved[max(-r, 0) : height - max(r, 0), max(-c, 0) : width - max(c, 0)] = image[
        max(r, 0) : height - max(-r, 0), max(c, 0) : width - max(-c, 0)
    ]
    return moved


def _grow(nearest: NDArray[np.int32], front: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Give an empty pixel the point in front among those of its neighbours."""
    grown_nearest, grown_front = nearest.copy(), front.copy()
    empty = np.isneginf(front)
    for step in _NEIGHBOURS:
        beside = _shift(front, step, -np.inf)
        take = empty & (beside > grown_front)
        grown_front[take] = beside[take]
        grown_nearest[take] = _shift(nearest, step, -1)[take]
    return grown_nearest, grown_front


def _close_gaps(
    nearest: NDArray[np.int32], front: NDArray[np.float32]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Give an empty pixel with points on opposite sides the one in front of them."""
    filled_nearest, filled_front = nearest.copy(), front.copy()
    for step in _NEIGHBOURS[:4:2] + _NEIGHBOURS[4:6]:
        opposite = (-step[0], -step[1])
        one, other = _shift(front, step, -np.inf), _shift(front, opposite, -np.inf)
        take = np.isneginf(filled_front) & ~np.isneginf(one) & ~np.isneginf(other)
        filled_front[take] = one[take]
        filled_nearest[take] = _shift(nearest, step, -1)[take]
    return filled_nearest, filled_front


def _shade(front: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return eye-dome lighting: exp(-strength * mean over neighbours of how far they stand in front)."""
    known = np.where(np.isneginf(front), np.float32(np.nan), front)
    total = np.zeros_like(front)
    for radius, weight in ((1, 0.6), (3, 0.4)):
        for r, c in _NEIGHBOURS:
            ahead = _shift(known, (r * radius, c * radius), np.nan) - known
            # Beyond a metre in front, further makes no darker: walls would drown the floor beside them.
            total += weight * np.nan_to_num(np.clip(ahead, 0.0, 1.0)) / radius
    shade: NDArray[np.float32] = np.exp(total * np.float32(-_SHADE_STRENGTH / (len(_NEIGHBOURS) * 0.25)))
    return shade


def color_image(
    raster: Raster, values: NDArray[np.float32], colors: tuple[str, ...], limits: tuple[float, float]
) -> NDArray[np.uint8]:
    """Return the (H, W, 3) picture of a raster with one value a point put on a colour scale."""
    table = scale(colors)
    visible = raster.nearest >= 0
    value = values[raster.nearest[visible]]
    span = max(limits[1] - limits[0], 1e-9)
    index = np.clip((value - limits[0]) * (255.0 / span), 0, 255).astype(np.uint8)
    image = np.empty((*raster.nearest.shape, 3), dtype=np.uint8)
    image[:] = GROUND
    image[visible] = (table[index] * raster.shade[visible][:, None]).astype(np.uint8)
    return image
