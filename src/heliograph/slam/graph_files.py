"""The files of a run's graph: loops.csv, gnss.csv, graph.g2o for other tools, and graph.npz, which holds everything."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from heliograph.arrays import Array
from heliograph.graph import Between, Covariance, FactorGraph, Symbol, Values, pose_graph_of, save_graph, write_g2o
from heliograph.lie import SE3, ExtendedPose, se3
from heliograph.slam.back_end import BackEnd
from heliograph.slam.gnss import write_gnss_table
from heliograph.slam.loops.ledger_file import write_ledger

__all__ = ["GRAPH_FILES", "write_graph_files"]

GRAPH_FILES = ("loops.csv", "graph.g2o", "graph.npz")


def write_graph_files(folder: Path, back_end: BackEnd, T_map_imu: Array | None = None) -> tuple[str, ...]:
    """Write the files of a back-end into a run's folder and return their names.

    Parameters
    ----------
    folder : Path
    back_end : BackEnd
    T_map_imu : (K, 4, 4) float64, optional
        The keyframes' poses that graph.npz holds, where they are not the back-end's.

    Raises
    ------
    OutputError
        One of them cannot be written.
    """
    write_ledger(folder / "loops.csv", back_end.ledger)
    write_g2o(folder / "graph.g2o", pose_graph_of(*_poses_and_steps(back_end)))
    graph, values = back_end.graph()
    save_graph(folder / "graph.npz", graph, values if T_map_imu is None else _with_poses(values, T_map_imu))
    account = back_end.account().gnss
    if account is not None:
        write_gnss_table(folder / "gnss.csv", account.fixes)
    return (*GRAPH_FILES, *(("gnss.csv",) if account is not None else ()), back_end.store.path.name)


def _with_poses(values: Values, T_map_imu: Array) -> Values:
    """Return values with other poses of the keyframes; velocities turn with their bodies."""
    out, keys = Values(), Symbol("X")(np.arange(len(T_map_imu)))
    poses = set(keys.tolist())
    for key in values.keys().tolist():
        if key not in poses:
            out.insert(key, values.at(key))
    before = values.at(keys)
    if isinstance(before, ExtendedPose):
        turn = T_map_imu[:, :3, :3] @ np.swapaxes(before.rotation, 1, 2)
        velocity = np.einsum("kij,kj->ki", turn, before.velocity)
        out.insert(
            keys,
            ExtendedPose.from_rotation_position_velocity(
                T_map_imu[:, :3, :3].copy(), T_map_imu[:, :3, 3].copy(), velocity
            ),
        )
    else:
        out.insert(keys, SE3(np.ascontiguousarray(T_map_imu)))
    return out


def _poses_and_steps(back_end: BackEnd) -> tuple[FactorGraph, Values]:
    """Return the keyframes' poses, the odometry's steps between them and the loops that stand."""
    graph, values = FactorGraph(), Values()
    keys, T = np.arange(len(back_end.chain)), back_end.chain.T_odom_imu
    values.insert(keys, SE3(back_end.T_map_imu))
    graph.fix(0)
    if len(keys) > 1:
        steps = se3.inverse(T[:-1]) @ T[1:]
        graph.add(Between(keys[:-1], keys[1:], SE3(steps), Covariance(back_end.chain.step_covariances[1:])))
    for entry in back_end.ledger.accepted():
        loop = entry.evidence
        graph.add(Between(loop.match, loop.query, SE3(loop.T_match_query), Covariance(loop.covariance)))
    return graph, values
