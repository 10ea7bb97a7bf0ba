"""Prototype; replaced by factors.CombinedImu."""
from __future__ import annotations
from dataclasses import replace
import numpy as np
from heliograph.config import ImuConfig
from heliograph.data import NavState
from heliograph.graph import Factor
from heliograph.imu import propagate
from heliograph.lie import S2, ExtendedPose, so3


def preint(imu, start_ns, end_ns, noise, config, bias):
    out = []
    st = imu.stamps_ns
    for k, (a, b) in enumerate(zip(start_ns, end_ns)):
        i0 = max(int(np.searchsorted(st, a, side="right")) - 1, 0)
        i1 = int(np.searchsorted(st, b, side="left")) + 1
        part = replace(imu, stamps_ns=st[i0:i1], gyro=imu.gyro[i0:i1], accel=imu.accel[i0:i1])
        state = NavState(stamp_ns=int(a), R_odom_imu=np.eye(3), p_odom=np.zeros(3), v_odom=np.zeros(3),
            gyro_bias=bias[k, :3].copy(), accel_bias=bias[k, 3:].copy(), g_odom=np.zeros(3), T_imu_lidar=np.eye(4), covariance=np.zeros((17, 17)))
        from heliograph import _core
        from heliograph.imu.propagation import _model
        vec = np.stack([state.p_odom, state.v_odom, state.gyro_bias, state.accel_bias, state.g_odom])
        stamps, R, p, v, F, Q, held = _core.propagate(part.stamps_ns, part.gyro, part.accel, int(a), int(b), np.eye(3), vec, np.zeros((3, 2)), _model(noise, config))
        out.append((R[-1], p[-1], v[-1], F[:9, 9:15], Q[:15, :15], (b - a) * 1e-9))
    R, p, v, J, Q, dt = (np.array(x) for x in zip(*out))
    return R, p, v, J, Q, dt


class Inertial(Factor):
    __slots__ = ()
    variables = (ExtendedPose, 6, ExtendedPose, 6, S2)
    rows = 15

    @staticmethod
    def residual(Xi, bi, Xj, bj, g, dR, dp, dv, J, b0, dt, gm):
        d = np.einsum("nij,nj->ni", J, bi - b0)
        G = g * gm[:, None]
        Ri = Xi[:, :3, :3]
        t = dt[:, None]
        up = lambda a: np.einsum("nji,nj->ni", Ri, a)
        M = dR @ so3.exp(d[:, :3])
        rR = so3.log(np.swapaxes(M, -1, -2) @ np.swapaxes(Ri, -1, -2) @ Xj[:, :3, :3])
        rp = up(Xj[:, :3, 3] - Xi[:, :3, 3] - Xi[:, :3, 4] * t - 0.5 * G * t * t) - dp - d[:, 3:6]
        rv = up(Xj[:, :3, 4] - Xi[:, :3, 4] - G * t) - dv - d[:, 6:9]
        return np.concatenate([rR, rp, rv, bj - bi], axis=1)
