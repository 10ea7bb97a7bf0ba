"""Sensors that do not sit at their pose: measurements brought to the frames of the poses, exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from heliograph.arrays import Array, Indices
from heliograph.errors import FormatError
from heliograph.graph.files.row_kinds import KINDS, matrices_of
from heliograph.graph.files.tables import Table
from heliograph.lie import se2, se3

__all__ = ["at_poses", "points_at_poses", "sensor_offsets"]


_TAGS = {2: ("PARAMS_SE2OFFSET", "VERTEX_SE2"), 3: ("PARAMS_SE3OFFSET", "VERTEX_SE3:QUAT")}


def sensor_offsets(path: Path, dimension: int, others: Sequence[tuple[int, str]]) -> dict[int, Array]:
    """Return T_pose_sensor (k, k) of every PARAMS_SE2OFFSET or PARAMS_SE3OFFSET line, by its number.

    Parameters
    ----------
    path : Path
        The file, for messages.
    dimension : int
        Dimension of the space, 2 or 3.
    others : sequence of (int, str)
        Lines that are neither values nor factors.

    Raises
    ------
    FormatError
        A line has another number of words, or a word that is no number.
    """
    tag, like = _TAGS[dimension]
    kind, offsets = KINDS[like], {}
    for line, text in others:
        words = text.split()
        if words[0] != tag:
            continue
        try:
            number, values = int(words[1]), np.array([float(word) for word in words[2:]])
        except (ValueError, IndexError):
            values = np.zeros(0)
        turn = values[3:] if dimension == 3 else np.ones(1)
        if len(values) != kind.numbers or not np.isfinite(values).all() or not np.abs(turn).max() > 0.0:
            raise FormatError(path, f"line {line}: {tag} takes an id and {kind.describe().split(', ')[1]}; correct it")
        offsets[number] = matrices_of(kind, values[None])[0]
    return offsets


def at_poses(table: Table, offsets: Mapping[int, Array]) -> tuple[Array, Array]:
    """Return what relative poses or priors of poses measure between or of the poses themselves.

    With sensors at T_i_a and T_j_b, ``Log(Z^-1 T_i_a^-1 X T_j_b)`` is ``Ad(T_j_b^-1) Log((T_i_a Z T_j_b^-1)^-1 X)``, so
    another measurement with another information gives the same cost at all poses.

    Parameters
    ----------
    table : Table
        Relative poses between sensors, with 0 or 2 offsets, or priors of sensors, with 0 or 1.
    offsets : mapping of int to (k, k) float64
        T_pose_sensor; those that are not there are the identity.

    Returns
    -------
    T : (N, k, k) float64
        T_i_j, or T_world_i.
    information : (N, d, d) float64
        Rotation first.
    """
    T, information = table.matrices, table.information
    if not _moved(table, offsets):
        return T, information
    ops = se2 if table.kind.dimension == 2 else se3
    sensors = [_of(table.parameters[:, k], offsets, T.shape[-1]) for k in range(table.kind.parameters)]
    back = ops.inverse(sensors[-1])
    T = T @ back if len(sensors) == 1 else sensors[0] @ T @ back
    Ad = ops.adjoint(back)
    turned = np.swapaxes(Ad, 1, 2) @ information @ Ad
    return np.asarray(T), np.asarray(0.5 * (turned + np.swapaxes(turned, 1, 2)))


def points_at_poses(table: Table, offsets: Mapping[int, Array]) -> tuple[Array, Array]:
    """Return p_pose (N, d) and information (N, d, d) of points seen by sensors; parameters as in `at_poses`."""
    p, information = table.numbers, table.information
    if not _moved(table, offsets):
        return p, information
    d = table.kind.dimension
    T = _of(table.parameters[:, 0], offsets, d + 1)
    R = T[:, :d, :d]
    turned = R @ information @ np.swapaxes(R, 1, 2)
    return np.asarray((R @ p[:, :, None])[..., 0] + T[:, :d, d]), 0.5 * (turned + np.swapaxes(turned, 1, 2))


def _moved(table: Table, offsets: Mapping[int, Array]) -> bool:
    """Return whether any sensor of the table sits elsewhere than at its pose."""
    if not table.kind.parameters or not offsets:
        return False
    used = (offsets.get(number) for number in np.unique(table.parameters).tolist())
    return any(T is not None and not np.array_equal(T, np.eye(len(T))) for T in used)


def _of(numbers: Indices, offsets: Mapping[int, Array], size: int) -> Array:
    """Return T_pose_sensor (N, k, k) of each number."""
    names, which = np.unique(numbers, return_inverse=True)
    return np.stack([offsets.get(name, np.eye(size)) for name in names.tolist()])[which.reshape(-1)]
