"""Everything about one estimate against one reference."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Trajectory
from heliograph.errors import ConfigError
from heliograph.metrics.trajectory import (
    AbsoluteError,
    RelativeError,
    absolute_trajectory_error,
    associate,
    best_time_offset,
    relative_pose_error,
)

__all__ = ["Evaluation", "evaluate"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """How an estimate compares with a reference.

    Parameters
    ----------
    align : str
        Alignment that the absolute error used.
    time_offset : float
        Seconds that were added to the estimate's stamps [s].
    poses_estimate, poses_reference, poses_compared : int
        Rows of both, and reference poses that the estimate covers.
    duration : float
        From the first to the last compared pose [s].
    path_length : float
        Length of the reference's path between those [m].
    absolute : AbsoluteError
        After alignment.
    relative : RelativeError
        Over `delta` metres of path.
    start_end_gap, start_end_gap_reference : float
        Straight distance between the first and the last of the compared positions [m].
    """

    align: str
    time_offset: float
    poses_estimate: int
    poses_reference: int
    poses_compared: int
    duration: float
    path_length: float
    absolute: AbsoluteError
    relative: RelativeError
    start_end_gap: float
    start_end_gap_reference: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON.

        The alignment becomes rows, a number that does not exist None; the error of each pose is left out.
        """
        out: dict[str, Any] = {f.name: _plain(getattr(self, f.name)) for f in fields(self)}
        for name in ("absolute", "relative"):
            record = getattr(self, name)
            out[name] = {f.name: _plain(getattr(record, f.name)) for f in fields(record) if f.name != "errors"}
        return out


def evaluate(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    align: str = "se3",
    delta: float = 10.0,
    time_offset: float | str = 0.0,
    max_gap_s: float = 0.5,
    offset_limit_s: float = 0.06,
) -> Evaluation:
    """Return absolute and relative errors of an estimate, interpolated at the reference's stamps.

    Parameters
    ----------
    estimate, reference : Trajectory
        Trajectories of the same body, in any two fixed frames.
    align : str
        ``"se3"``, ``"yaw"``, ``"origin"`` or ``"none"``; see `heliograph.metrics.align`.
    delta : float
        Path length of the relative error [m].
    time_offset : float or "auto"
        Seconds to add to the estimate's stamps; ``"auto"`` finds them with `heliograph.metrics.best_time_offset`.
    max_gap_s : float
        Longest pause of the estimate to interpolate over [s].
    offset_limit_s : float
        Limit of the automatic offset [s].

    Raises
    ------
    DataError
        No overlap in time, or an alignment that the path does not determine.
    ConfigError
        An unknown word.
    """
    if isinstance(time_offset, str):
        if time_offset != "auto":
            raise ConfigError(f"time offset '{time_offset}' is neither a number of seconds nor 'auto'")
        time_offset = best_time_offset(estimate, reference, limit_s=offset_limit_s, delta=delta, max_gap_s=max_gap_s)
    pair = associate(estimate, reference, time_offset=time_offset, max_gap_s=max_gap_s)
    return Evaluation(
        align=align,
        time_offset=time_offset,
        poses_estimate=len(estimate),
        poses_reference=len(reference),
        poses_compared=len(pair),
        duration=float(pair.stamps_ns[-1] - pair.stamps_ns[0]) * 1e-9,
        path_length=float(pair.distance[-1] - pair.distance[0]),
        absolute=absolute_trajectory_error(pair, mode=align),
        relative=relative_pose_error(pair, delta=delta),
        start_end_gap=_gap(pair.T_estimate),
        start_end_gap_reference=_gap(pair.T_reference),
    )


def _gap(T: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(T[-1, :3, 3] - T[0, :3, 3]))


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever the records hold
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
