"""The scan lines of a sweep: by ring, or, where no rings are told, by elevation or by the order of the points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array, as_points, freeze
from heliograph.config import FeatureConfig
from heliograph.errors import DataError

__all__ = ["LINES_NEED", "LineKind", "LineRule", "ScanLines", "find_line_rule", "scan_lines"]

LineKind: TypeAlias = Literal["ring", "elevation", "order", "rows"]
"""What tells the lines: the rings of the message, lasers' elevations that stand apart, every k-th point in the order of
the message, or rows of equal height by elevation."""

_STRIDES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 32, 40, 64, 80, 128)  # lasers that a driver may interleave
_LEVEL_DEG = 2.0  # spread of all elevations below which there is one line only [deg]
LINES_NEED = 1000
"""Points below which a cloud does not tell its lines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineRule:
    """How the lines of a sensor are told.

    Parameters
    ----------
    kind : str
        See `LineKind`.
    stride : int
        For ``"order"``: points of one line are this many places apart.
    step : float
        Median angle from one point of a line to the next [rad].
    why : str
        What it was inferred from, for people.
    """

    kind: LineKind
    stride: int = 1
    step: float = 0.0
    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanLines:
    """Points in the order of their lines.

    Parameters
    ----------
    order : (M,) int32
        Indices of the points, line by line, along each line.
    starts : (L + 1,) int32
        Where each line begins in `order`, and where the last one ends.
    doubles : int
        Returns left out because another one of the same beam lies farther.
    """

    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    doubles: int = 0

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.starts) - 1


def scan_lines(
    points: NDArray[np.float32],
    offsets_ns: NDArray[np.int32],
    ring: NDArray[np.uint16] | None,
    rule: LineRule,
    config: FeatureConfig,
) -> ScanLines:
    """Return the lines of a sweep; along a line points follow by time, by azimuth where a line's times are all one.

    Parameters
    ----------
    points : (N, 3) float32
        Lidar frame, each at its own time [m]. Those that are not finite, or at the origin, are left out.
    offsets_ns : (N,) int32
        Time of each [ns].
    ring : (N,) uint16 or None
        Needed by the rule ``"ring"`` only.
    rule : LineRule
    config : FeatureConfig

    Raises
    ------
    DataError
        Arrays of another dtype or shape, or no rings where the rule needs them.
    """
    points = as_points("points", points)
    offsets_ns = as_array("offsets_ns", offsets_ns, np.int32, (len(points),))
    if rule.kind == "ring":
        if ring is None:
            raise DataError("the scan has no rings although the ones before had them; see find_line_rule")
        rows = as_array("ring", ring, np.uint16, (len(points),))
    elif rule.kind == "order":
        rows = (np.arange(len(points)) % rule.stride).astype(np.uint16)
    else:
        by_elevation: Any = _core.elevation_rows(points, np.radians(config.row_height_deg))
        rows = by_elevation.rows
    found: Any = _core.scan_lines(points, offsets_ns, rows)
    return ScanLines(order=found.order, starts=found.starts, doubles=int(found.doubles))


def find_line_rule(
    points: NDArray[np.float32],
    offsets_ns: NDArray[np.int32],
    ring: NDArray[np.uint16] | None,
    config: FeatureConfig,
) -> LineRule:
    """Tell from one sweep how a sensor's lines are to be found.

    Rings are believed where points of one follow each other closely. Without them fixed lasers show as elevations that
    stand apart; a solid-state scanner, and a spinning one stored ring by ring, keeps neighbours at a constant distance
    in the message; what is left is sorted into rows by elevation.

    Raises
    ------
    DataError
        Too few points to tell, all of them in one plane through the sensor, or no lines whatever is tried.
    """
    points = as_points("points", points)
    seen = points[np.isfinite(points).all(axis=1) & (points != 0.0).any(axis=1)]
    if len(seen) < LINES_NEED:
        raise DataError(
            f"{len(seen)} points do not tell scan lines, {LINES_NEED} would; use --odometry filter for a scan as sparse"
        )
    elevation = np.degrees(np.arctan2(seen[:, 2], np.hypot(seen[:, 0], seen[:, 1])))
    spread = float(np.ptp(np.quantile(elevation, (0.01, 0.99))))
    if spread < _LEVEL_DEG:
        raise DataError(
            f"all points lie within {spread:.1f} deg of one plane: a single scan line has edges but no surfaces; "
            f"LOAM needs several, a map in 3D any odometry"
        )
    tried: list[str] = []
    for rule in _candidates(points, ring, config):
        step = rule.step if rule.kind == "order" else _step(points, offsets_ns, ring, rule, config)
        if np.degrees(step) <= config.max_step_deg:
            return LineRule(kind=rule.kind, stride=rule.stride, step=step, why=_why(rule, step, ring))
        tried.append(f"{rule.kind} {np.degrees(step):.1f}")
    raise DataError(
        f"the points follow no scan lines: the median angle from one to the next is [deg] {', '.join(tried)}, at most "
        f"{config.max_step_deg:g} is a line; use --odometry filter, or raise loam.features.max_step_deg"
    )


def _candidates(points: NDArray[np.float32], ring: NDArray[np.uint16] | None, config: FeatureConfig) -> list[LineRule]:
    rules = []
    if ring is not None and len(np.unique(ring)) > 1:
        rules.append(LineRule(kind="ring"))
    by_elevation: Any = _core.elevation_rows(points, np.radians(config.row_height_deg))
    if by_elevation.discrete:
        rules.append(LineRule(kind="elevation"))
    steps = [_core.step_angle(points, stride) for stride in _STRIDES]
    best = int(np.argmin(steps))
    return [*rules, LineRule(kind="order", stride=_STRIDES[best], step=steps[best]), LineRule(kind="rows")]


def _step(
    points: NDArray[np.float32],
    offsets_ns: NDArray[np.int32],
    ring: NDArray[np.uint16] | None,
    rule: LineRule,
    config: FeatureConfig,
) -> float:
    order = scan_lines(points, offsets_ns, ring, rule, config).order
    return float(_core.step_angle(np.ascontiguousarray(points[order]), 1))


def _why(rule: LineRule, step: float, ring: NDArray[np.uint16] | None) -> str:
    missing = "no rings are told" if ring is None else "the rings do not tell the lines"
    text = {
        "ring": "by ring",
        "elevation": f"by elevation, because {missing}",
        "order": f"every {rule.stride}. point of the message, because {missing}"
        if rule.stride > 1
        else f"in the order of the message, because {missing}",
        "rows": f"in rows by elevation, because {missing} and the points are in no order",
    }[rule.kind]
    return f"{text}; {np.degrees(step):.2f} deg from point to point"
