"""A saved map from where users have it: the folder of a run, or a cloud by any software."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from heliograph.arrays import Array
from heliograph.config import RunConfig
from heliograph.errors import DataError, FormatError, GraphError
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import Marginals, Symbol, load_graph
from heliograph.io.files.cloud_points import POINT_SUFFIXES, read_points
from heliograph.lie import se3
from heliograph.localization.saved_map import SavedMap, map_of_keyframes, map_of_points
from heliograph.revision import RunGraph, open_run_graph

__all__ = ["open_map"]

X = Symbol("X")
_LOOKED_AT = 10  # keyframes, for the first matched one
_TILT = 0.2  # gravity of a run may lean this far from the map's z axis: 11 degrees [rad]


def open_map(path: Path | str, config: RunConfig | None = None) -> SavedMap:
    """Open a map to localise in.

    Parameters
    ----------
    path : Path or str
        The folder of a run with a graph, whose keyframes make the map as it stands in ``trajectory.tum``; or a cloud
        (PLY, PCD, LAS, LAZ, or text), z up, in metres.
    config : RunConfig, optional

    Raises
    ------
    FormatError
        Neither of them, or damaged, or a store of another version.
    DataError
        The map is too small to tell places apart, of another unit, or z does not point up.
    """
    path, config = Path(path), config or RunConfig()
    if path.is_dir():
        run = open_run_graph(path)
        _check_level(run)
        there = [index for index in range(len(run.store)) if not run.dropped(index)]
        clouds = [run.points(index) for index in there]
        known = _covariances(run)
        return map_of_keyframes(
            clouds,
            np.ascontiguousarray(run.T_map_imu[there]),
            None if known is None else lambda index: known(there[index]),
            config=config.localization,
            places=config.places,
            maps=config.map,
        )
    if not path.exists():
        raise FormatError(path, "is not there; give --map the folder of a run, or a cloud")
    if path.suffix.lower() not in POINT_SUFFIXES:
        raise FormatError(path, f"is no map; give the folder of a run or one of {', '.join(POINT_SUFFIXES)}")
    return map_of_points(read_points(path), config=config.localization, places=config.places, maps=config.map)


def _covariances(run: RunGraph) -> Callable[[int], Array] | None:
    """Return what gives the covariance of a keyframe against the first matched one; None where the graph is not there.

    The very first scan was matched to nothing: against it the graph knows the others by the IMU alone, although all of
    them were matched to its points.
    """
    matched = [k for k in range(min(len(run.store), _LOOKED_AT)) if run.store[k].lidar_information.any()]
    first = matched[0] if matched else 0
    try:
        graph, values = load_graph(run.folder / "graph.npz", factors=SENSOR_FACTORS)
        marginals = Marginals(graph, values)
    except (FormatError, GraphError):
        return None

    def relative(index: int) -> Array:
        if index <= first:  # its points are what the first matched one was matched to
            return np.zeros((6, 6))
        joint = marginals.joint(X(np.array([first, index])))
        d = len(joint) // 2
        pose = np.r_[0:6, d : d + 6]
        T = run.T_map_imu
        J = np.hstack([-se3.adjoint(se3.inverse(T[index]) @ T[first]), np.eye(6)])
        return np.asarray(J @ joint[np.ix_(pose, pose)] @ J.T)

    return relative


def _check_level(run: RunGraph) -> None:
    """Raise `DataError` where the run's own gravity does not point down in its map."""
    for index in (0, len(run.store) - 1):
        keyframe = run.store[index]
        g = keyframe.g_odom
        if not np.linalg.norm(g) > 0.0:
            continue
        down = run.T_map_imu[index, :3, :3] @ keyframe.T_odom_imu[:3, :3].T @ g / np.linalg.norm(g)
        if down[2] > -np.cos(_TILT):
            lean = float(np.degrees(np.arccos(np.clip(-down[2], -1.0, 1.0))))
            raise DataError(
                f"{run.folder}: gravity leans {lean:.0f} deg from the map's z axis, and a search takes z for up: run "
                "the recording again with its IMU"
            )
