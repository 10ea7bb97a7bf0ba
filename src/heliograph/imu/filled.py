"""Samples that nobody measured: some recorders fill a gap with a straight line, which then looks like perfect data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.data import ImuBatch
from heliograph.errors import DataError

__all__ = ["drop_filled"]

_DISTANCE_SHARE = (
    1e-3  # of the usual distance from the neighbours' line: real samples carry noise, filled ones only rounding
)


def drop_filled(imu: ImuBatch, *, least: int = 5) -> tuple[ImuBatch, NDArray[np.int64]]:
    """Take out samples that were interpolated by whoever wrote the recording, so that the gap is seen as one.

    A sample is taken for filled if every channel lies on the straight line between its neighbours, a thousand times
    closer than is usual in the recording, and so do at least ``least`` in a row. An IMU without noise (simulated) has
    nothing unusual and keeps all.

    Parameters
    ----------
    imu : ImuBatch
        Samples of one recording.
    least : int
        The fewest samples of a filled gap.

    Returns
    -------
    imu : ImuBatch
        Without them; its distance between stamps is the gap.
    gaps_ns : (G, 2) int64
        The last measured stamp before and the first after each gap [ns].

    Raises
    ------
    DataError
        ``least`` is not positive.
    """
    if least < 1:
        raise DataError(f"least={least}: a filled gap has at least one sample")
    none = np.zeros((0, 2), dtype=np.int64)
    if len(imu) < least + 2:
        return imu, none
    t, readings = imu.stamps_ns, np.hstack([imu.gyro, imu.accel])
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    off = np.abs(readings[1:-1] - readings[:-2] - share * (readings[2:] - readings[:-2]))
    usual = np.median(off, axis=0)
    on_line = np.concatenate([[False], ((off < _DISTANCE_SHARE * usual) | (usual == 0.0)).all(axis=1), [False]])
    if not usual.any():
        return imu, none
    edges = np.flatnonzero(np.diff(on_line.astype(np.int8))) + 1
    first, last = edges[::2], edges[1::2]
    long = last - first >= least
    filled = np.zeros(len(t), dtype=bool)
    for a, b in zip(first[long], last[long], strict=True):
        filled[a:b] = True
    kept = replace(imu, stamps_ns=t[~filled], gyro=imu.gyro[~filled], accel=imu.accel[~filled])
    return kept, np.stack([t[first[long] - 1], t[last[long]]], axis=1)
