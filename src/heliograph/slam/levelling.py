"""Which way was up, by long windows: mean specific force less the acceleration that the odometry saw.

An accelerometer shows the force that holds the body up, and its accelerations. Over a long window the latter are known
from the odometry's positions, however much those drift: what is left is up, to a fraction of a milliradian. It holds
roll, pitch and with them height where no preintegrated factor does: with poses of another system, and for steps that
have left the window of inertial smoothing. Equation (5) of docs/theory/slam.md.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.config import ImuConfig, SlamConfig
from heliograph.data import ImuNoise, Keyframe
from heliograph.factors import MeanForce
from heliograph.graph import Covariance, FactorGraph, Prior, Symbol, Values
from heliograph.imu import preintegrate
from heliograph.lie import so3
from heliograph.slam.growing_rows import GrowingRows
from heliograph.snapshots import PART, Stateful, array

__all__ = ["Levelling"]

X, U, A = Symbol("X"), Symbol("U"), Symbol("A")
_FEWEST = 5  # keyframes of a window: its positions are fitted by a parabola
_LEAST = 0.02  # sigma of a mean force whatever else is known: scale, timing, bending within a step [m/s^2]
_UNKNOWN = 3.0  # sigma of up in an unknown frame, across what the first window shows [m/s^2]
_LENGTH = 0.02  # sigma of gravity's length [m/s^2]
_HELD = 1e-6  # sigma of an up that is known by definition [m/s^2]
_BROKEN = 50.0  # a step as uncertain as this, one-sigma, begins anew [m]


class Levelling(Stateful):
    """Gathers keyframes into windows that do not overlap, and says of each which way was up at its middle.

    The accelerometer's bias is a variable of the graph, one a session: what all windows share is not counted as if each
    told it anew. Up is a variable too. Where the map's z axis points up by definition it is held; in the frame of
    another system's poses it is found.

    Parameters
    ----------
    slam : SlamConfig
        `SlamConfig.level_window`; none are made where it is zero.
    imu : ImuConfig
    up_known : bool
        Whether the map's z axis points up by definition.
    """

    _STATE: ClassVar = {
        "_session": int,
        "_began": int,
        "_keys": PART,
        "_forces": PART,
        "_turnings": PART,
        "_covariances": PART,
        "_ups": PART,
        "_indices": [int],
        "_rows": [array(np.float64, None)],
    }

    def __init__(self, slam: SlamConfig, imu: ImuConfig, *, up_known: bool) -> None:
        self._window, self._imu, self._known = slam.level_window, imu, up_known
        self._noise = ImuNoise(
            gyro=imu.gyro_noise, accel=imu.accel_noise, gyro_walk=imu.gyro_walk, accel_walk=imu.accel_walk
        )
        self._session, self._began = 0, -1  # the newest with its own bias, and the last that has one in the graph
        self._keys = GrowingRows(2, dtype=np.int64)  # keyframe, session
        self._forces, self._turnings, self._covariances = GrowingRows(3), GrowingRows(3, 3), GrowingRows(3, 3)
        self._ups = GrowingRows(3)  # up as the first window had it: none or one
        self._indices: list[int] = []
        self._rows: list[Array] = []  # of the open window: time, pose, S, V, D, E, covariance of the step, see `_row`

    def add(self, before: Keyframe, keyframe: Keyframe) -> tuple[FactorGraph, Values]:
        """Take the step to the next keyframe; return what a window that it closes says, and new variables."""
        if not self._window or not len(keyframe.imu) or _is_broken(keyframe):
            self._session += int(_is_broken(keyframe))
            self._indices, self._rows = [], []
            return FactorGraph(), Values()
        if not self._rows:
            self._indices = [before.index]
            start = np.zeros(3 + 3 + 9 + 9)
            self._rows = [np.concatenate([[1e-9 * before.stamp_ns], before.T_odom_imu.ravel(), start, np.zeros(36)])]
        self._rows.append(self._row(before, keyframe))
        self._indices.append(keyframe.index)
        if len(self._rows) < _FEWEST or self._rows[-1][0] - self._rows[0][0] < self._window:
            return FactorGraph(), Values()
        self._close()
        return self._said(len(self._keys.all) - 1)

    def factors(self) -> FactorGraph:
        """Return all that was said so far, priors included."""
        whole, began = FactorGraph(), -1
        for k in range(len(self._keys.all)):
            session = int(self._keys.all[k, 1])
            for group in self._factors(k, up=k == 0, bias=session != began).groups():
                whole.adopt(group)
            began = session
        return whole

    def _row(self, before: Keyframe, keyframe: Keyframe) -> Array:
        """Integrate the step: S and V are the body's way and speed by its forces alone, D and E theirs by a bias."""
        seconds, R = 1e-9 * (keyframe.stamp_ns - before.stamp_ns), before.T_odom_imu[:3, :3]
        bias = before.gyro_bias
        for _ in range(2):  # the second time with the gyroscope brought to the turn that the odometry saw
            motion = preintegrate(
                keyframe.imu, before.stamp_ns, keyframe.stamp_ns, noise=self._noise, config=self._imu, gyro_bias=bias
            )
            off = so3.log(motion.delta_R[0].T @ R.T @ keyframe.T_odom_imu[:3, :3])
            bias = bias - off / seconds
        _, T, S, V, D, E, _ = _parts(self._rows[-1])
        turned = R @ motion.delta_R[0]
        by_bias = motion.bias_jacobian[0]
        S_after, V_after = S + V * seconds + R @ motion.delta_p[0], V + R @ motion.delta_v[0]
        D_after, E_after = D + E * seconds - turned @ by_bias[3:6, 3:6], E - turned @ by_bias[6:9, 3:6]
        T = keyframe.T_odom_imu
        parts = [T.ravel(), S_after, V_after, D_after.ravel(), E_after.ravel(), keyframe.step_covariance.ravel()]
        return np.concatenate([[1e-9 * keyframe.stamp_ns], *parts])

    def _close(self) -> None:
        """Sum the open window up, and begin the next one at its end."""
        t, T, S, V, D, _, Q = (np.stack(part) for part in zip(*map(_parts, self._rows), strict=True))
        t = t - 0.5 * (t[0] + t[-1])
        m = int(np.argmin(np.abs(t)))
        # p - S is a parabola whose second derivative is gravity: up is a weighted sum of it.
        weights = -2.0 * np.linalg.pinv(np.vander(t, 3, increasing=True))[2]
        p, R = T[:, :3, 3] - T[m, :3, 3], T[:, :3, :3]
        up = weights @ (p - S)
        back = R[m].T
        covariance = (_LEAST**2 + self._imu.accel_walk**2 * (t[-1] - t[0])) * np.eye(3)
        for j in range(1, len(t)):
            late, w = slice(j, None), weights[j:]
            # The step's shift moves all that follows; its turn moves and turns it, seen from the middle.
            shift = w.sum() * R[j]
            bent = w @ (p[late] - p[j] - (S[late] - S[j] - V[j] * (t[late] - t[j])[:, None])) - (up if j <= m else 0.0)
            turn = so3.hat(bent) @ R[j]
            covariance += back @ (shift @ Q[j, 3:, 3:] @ shift.T + turn @ Q[j, :3, :3] @ turn.T) @ back.T
        self._keys.append(np.array([self._indices[m], self._session]))
        self._forces.append(back @ up)
        self._turnings.append(-back @ np.einsum("k,kij->ij", weights, D))
        self._covariances.append(0.5 * (covariance + covariance.T))
        if len(self._ups.all) == 0:
            self._ups.append(np.array([0.0, 0.0, self._imu.gravity]) if self._known else _scaled(up, self._imu.gravity))
        last = self._rows[-1].copy()
        last[17:] = 0.0
        self._indices, self._rows = self._indices[-1:], [last]

    def _said(self, number: int) -> tuple[FactorGraph, Values]:
        session, values = int(self._keys.all[number, 1]), Values()
        begins = session != self._began
        if number == 0:
            values.insert(U(0), self._ups.all[0].copy())
        if begins:
            values.insert(A(session), np.zeros(3))
            self._began = session
        return self._factors(number, up=number == 0, bias=begins), values

    def _factors(self, number: int, *, up: bool, bias: bool) -> FactorGraph:
        """Return what a window says, with the priors of the variables that begin with it."""
        graph = FactorGraph()
        index, session = (int(k) for k in self._keys.all[number])
        graph.add(
            MeanForce(
                X(index), U(0), A(session), self._forces.all[number], self._turnings.all[number],
                Covariance(np.ascontiguousarray(self._covariances.all[number])),
            )
        )  # fmt: skip
        if up:
            z = self._ups.all[0]
            along = np.outer(z, z) / (z @ z)
            held, free = (_HELD, _HELD) if self._known else (_LENGTH, _UNKNOWN)
            graph.add(Prior(U(0), z.copy(), Covariance(held**2 * along + free**2 * (np.eye(3) - along))))
        if bias:
            graph.add(Prior(A(session), np.zeros(3), Covariance(self._imu.accel_bias_sigma**2 * np.eye(3))))
        return graph


def _parts(row: Array) -> tuple[Array, ...]:
    """Return time, pose, S, V, D, E and the step's covariance of a row."""
    T, D, E = row[1:17].reshape(4, 4), row[23:32].reshape(3, 3), row[32:41].reshape(3, 3)
    return np.asarray(row[0]), T, row[17:20], row[20:23], D, E, row[41:77].reshape(6, 6)


def _scaled(vector: Array, length: float) -> Array:
    return np.asarray(length * vector / np.linalg.norm(vector))


def _is_broken(keyframe: Keyframe) -> bool:
    return float(np.sqrt(np.trace(keyframe.step_covariance[3:, 3:]))) >= _BROKEN
