"""A first guess: the clock's offset and the mounting's rotation from turns that both sensors saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.data import ImuBatch
from heliograph.lie import so3

__all__ = ["Coarse", "align_turns"]


_WINDOW_SCANS = 3  # scans over which turns are compared
_TURN_SIGMA = 0.01  # of one comparison: the LiDAR's odometry without de-skewing by an IMU [rad]
_OFFSET_STEP_S = 0.004  # of the search over offsets [s]
_SEARCH_ROUNDS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Coarse:
    """Offset and rotation that fit the turns best.

    Parameters
    ----------
    offset : float
        What the IMU's clock shows more than the LiDAR's [s].
    R_imu_lidar : (3, 3) float64
    gyro_bias : (3,) float64
        [rad/s].
    rms : float
        Root mean square of the turns' differences [rad].
    """

    offset: float
    R_imu_lidar: Array
    gyro_bias: Array
    rms: float

    def __post_init__(self) -> None:
        freeze(self)


def align_turns(
    ends_ns: NDArray[np.int64],
    R_odom_lidar: Array,
    imu: ImuBatch,
    *,
    R_prior: Array,
    sigma_rotation: float,
    search: float,
    sigma_offset: float,
) -> Coarse:
    """Search over clock offsets; for each, the rotation has a closed form.

    Minimises ``sum |phi_imu(o) - R phi_lidar - b span|^2 / s^2`` plus the priors of R and of the offset o, eq. (2) of
    docs/theory/calibration.md: for one o it is Wahba's problem with the prior as one more term, by SVD, alternated
    with the mean for the gyroscope's bias b. The prior keeps a turn about the only axis that the motion turned about.

    Parameters
    ----------
    ends_ns : (N,) int64
        Stamps of the LiDAR's poses [ns].
    R_odom_lidar : (N, 3, 3) float64
    imu : ImuBatch
        All samples.
    R_prior : (3, 3) float64
        Mounting to start from, known to ``sigma_rotation`` [rad] an axis.
    search, sigma_offset : float
        Offsets looked at on either side, and one-sigma of what is expected [s].
    """
    window = min(_WINDOW_SCANS, len(ends_ns) - 1)
    turns = so3.log(np.swapaxes(R_odom_lidar[:-window], -1, -2) @ R_odom_lidar[window:])
    stamps, R_gyro = _integrate_gyro(imu)
    prior = R_prior / (2.0 * sigma_rotation**2)  # (1/2s^2) tr(R_prior^T R): the log of a narrow density about R_prior

    def cost(offset: float) -> tuple[float, Coarse]:
        gyro, spans, inside = _turns_at(stamps, R_gyro, ends_ns + round(1e9 * offset), window)
        found = _rotation(turns[inside], gyro[inside], spans[inside], prior, offset)
        return found.rms**2 / _TURN_SIGMA**2 * (len(turns) / window) + (offset / sigma_offset) ** 2, found

    centre, width = 0.0, search
    step = min(_OFFSET_STEP_S, search)
    for _ in range(_SEARCH_ROUNDS):
        grid = centre + np.arange(-width, width + 0.5 * step, step)
        centre = float(grid[int(np.argmin([cost(float(o))[0] for o in grid]))])
        width, step = step, step / 4.0
    return cost(centre)[1]


def _rotation(turns: Array, gyro: Array, spans: Array, prior: Array, offset: float) -> Coarse:
    bias, R = np.zeros(3), np.eye(3)
    for _ in range(6):
        free = gyro - spans[:, None] * bias
        U, _, Vt = np.linalg.svd(free.T @ turns / (_WINDOW_SCANS * _TURN_SIGMA**2) + prior)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        bias = ((gyro - turns @ R.T) * spans[:, None]).sum(axis=0) / (spans**2).sum()
    residual = gyro - spans[:, None] * bias - turns @ R.T
    return Coarse(offset=offset, R_imu_lidar=R, gyro_bias=bias, rms=float(np.sqrt(np.mean(residual**2))))


def _integrate_gyro(imu: ImuBatch) -> tuple[NDArray[np.int64], Array]:
    """Return the gyroscope's own orientation at its samples, from an arbitrary first one."""
    rate = 0.5 * (imu.gyro[1:] + imu.gyro[:-1])
    R = so3.exp(rate * (np.diff(imu.stamps_ns) * 1e-9)[:, None])
    out = np.empty((len(imu), 3, 3))
    out[0] = np.eye(3)
    for k, step in enumerate(R):
        out[k + 1] = out[k] @ step
    return imu.stamps_ns, out


def _turns_at(
    stamps: NDArray[np.int64], R: Array, at_ns: NDArray[np.int64], window: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return turns between stamps ``window`` apart, their spans [s], and which lie inside the samples."""
    k = np.clip(np.searchsorted(stamps, at_ns, side="right") - 1, 0, len(stamps) - 2)
    share = (at_ns - stamps[k]) / (stamps[k + 1] - stamps[k])
    step = so3.log(np.swapaxes(R[k], -1, -2) @ R[k + 1])
    here = R[k] @ so3.exp(np.clip(share, 0.0, 1.0)[:, None] * step)
    inside = (at_ns >= stamps[0]) & (at_ns <= stamps[-1])
    turns = so3.log(np.swapaxes(here[:-window], -1, -2) @ here[window:])
    spans = np.asarray((at_ns[window:] - at_ns[:-window]) * 1e-9, dtype=np.float64)
    return turns, spans, np.asarray(inside[:-window] & inside[window:])
